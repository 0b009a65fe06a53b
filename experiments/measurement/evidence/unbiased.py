"""Products of a log's features without what the links' noise adds to them.

Measured motion goes into replays with its sensors' noise. With a little more of it, drawn anew, products of a feature
and the residual grow by what the noise of the log itself has put there, but for noise of second order.
"""

from dataclasses import replace

from experiments.measurement.evidence.features import Change, Products
from experiments.measurement.evidence.log_evidence import Evidence, Point
from experiments.measurement.evidence.untold import without_untold


def unbiased_products(log: Evidence, at: Point, changes: list[Change], biased: Products) -> Products:
    """Products of changes and the residual at a point as if the links' motion had been measured without noise, from
    what the log's own `products` are.

    Rows that no replay tells are left out: there it does not add, it throws.
    """
    if log.drive is None:
        return biased
    told = without_untold(log, at)
    own = biased if told is log else told.products(at, changes)
    noisier = replace(told, drive=replace(told.drive, motion=told.drive.renoised[0]))
    again = noisier.products(at, changes)
    gram = own.gram.copy()
    gram[:, -1, :-1] = 2.0 * own.gram[:, -1, :-1] - again.gram[:, -1, :-1]
    gram[:, :-1, -1] = gram[:, -1, :-1]
    return replace(own, gram=gram)
