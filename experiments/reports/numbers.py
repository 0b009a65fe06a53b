"""Numbers as people read them."""

from typing import Final

DASH: Final = "–"
_SUPERSCRIPT: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 3) -> str:
    """A number for people: `digits` significant figures, a true minus sign, no exponent where avoidable."""
    if value != value:
        return DASH
    if value == 0:
        return "0"
    text = f"{value:.{digits}g}"
    if "e" in text and 1e-4 <= abs(value) < 1e7:
        text = f"{value:.0f}"
    elif "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return minus(text)


def minus(text: str) -> str:
    """With true minus signs."""
    return text.replace("-", "\N{MINUS SIGN}")


def percent(share: float, decimals: int = 0) -> str:
    """A share for people: '12 %'."""
    return f"{100 * share:.{decimals}f}\N{NO-BREAK SPACE}%"
