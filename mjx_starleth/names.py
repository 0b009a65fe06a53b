"""Names and order of legs and joints, and the mirror signs of the X configuration (FACTS 1)."""

from typing import Final

LEGS: Final = ("LF", "RF", "LH", "RH")
JOINTS: Final = ("HAA", "HFE", "KFE")
JOINT_NAMES: Final = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)

# +1 fore / -1 hind and +1 left / -1 right, in the order of LEGS
FORE_SIGN: Final = (1.0, 1.0, -1.0, -1.0)
LEFT_SIGN: Final = (1.0, -1.0, 1.0, -1.0)

# What a number given for the left fore leg becomes on each leg: right legs mirror HAA, hind legs HFE and KFE.
JOINT_SIGN: Final = tuple(sign for fore, left in zip(FORE_SIGN, LEFT_SIGN, strict=True) for sign in (left, fore, fore))
