"""In a log that is explained, the one effect that stands out yet: of what noise looks like, none comes near its score.

The links' noise goes into a replay's residual and into what an effect would change in it, alike, and where a spring
pulls one way only that looks like an effect (errors in variables; Fuller, Measurement Error Models, doi
10.1002/9780470316665). The same noise drawn once more does the same once more, which tells its share of a score. Of
the scores with that share and without it the lower counts.
"""

from collections.abc import Sequence

from experiments.effects.places import mask
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.unbiased import unbiased_products
from experiments.measurement.fits.fit_types import Refitted
from experiments.measurement.fits.footprint import noise_at
from experiments.measurement.selection.belief import all_blocks
from experiments.measurement.selection.finalists import Round
from experiments.measurement.selection.linear_score import Scored, scored_at

# Of the 17 robots without an effect that these were set on, the best score was 664, and the largest share 2.6 %.
LONE_GAIN, LONE_SHARE = 150.0, 0.03  # of an effect that stands out: its score, and what that is of the noise there
SURE_GAIN = 700.0  # a score that is enough whatever its share
ABOVE_ELSEWHERE = 3.0  # times the best score of an effect that acts elsewhere
SAME_PLACE_RIVAL = 0.25  # of the best score: others there that have less do not explain the same


def lone(logs: Sequence[Evidence], fit: Refitted, ranking: Sequence[Scored], round_: Round) -> list[Scored]:
    """The effect of a ranking that stands alone, best place first, and those that might be meant instead; else none."""
    if ranking[0].gain < LONE_GAIN:
        return []
    lower = without_noise(logs, fit, ranking, round_)
    best, names = lower[0], logs[0].atoms.joint_names
    elsewhere = max((s.gain for s in lower if not _meet(s, best, names)), default=0.0)
    share = LONE_SHARE * noise_at(best.effect, best.where, logs, all_blocks(logs))
    if best.gain < max(LONE_GAIN, min(share, SURE_GAIN), ABOVE_ELSEWHERE * elsewhere):
        return []
    return [s for s in lower if s.gain > SAME_PLACE_RIVAL * best.gain]


def without_noise(logs: Sequence[Evidence], fit: Refitted, ranking: Sequence[Scored], round_: Round) -> list[Scored]:
    """A ranking with each score as low as without what the links' noise adds to it, best first."""
    each = zip(logs, fit.points, round_.products, strict=True)
    products = [unbiased_products(log, at, round_.changes, biased) for log, at, biased in each]
    variants = list({id(s.variant): s.variant for s in ranking}.values())
    found = scored_at(logs, products, fit, round_.nominal, round_.changes, variants)
    gain = {(id(s.variant), s.where): s.gain for s in found}
    lower = [s._replace(gain=min(s.gain, gain[id(s.variant), s.where])) for s in ranking]
    return sorted(lower, key=lambda s: -s.gain)


def _meet(one: Scored, other: Scored, joint_names: tuple[str, ...]) -> bool:
    """Whether two hypotheses act at a joint, or part of the plant, in common."""
    axis = one.effect.axis
    if axis != other.effect.axis:
        return False
    return bool((mask(one.where, axis, joint_names) * mask(other.where, axis, joint_names)).any())
