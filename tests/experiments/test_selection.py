"""Which of several finalists is named, and which count as its rivals."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.effects import LIBRARY
from experiments.measurement.evidence.body_evidence import FELT_BY_BODIES, FEWEST
from experiments.measurement.evidence.drive_evidence import FELT_BY_DRIVES
from experiments.measurement.evidence.parts import Part, Rest, enough
from experiments.measurement.fits.fit_types import Placed, Refitted
from experiments.measurement.fits.refit import _plausible
from experiments.measurement.selection import finalists, select
from experiments.measurement.selection import verdict as verdicts
from experiments.measurement.selection.belief import (
    Finalist,
    at_end_of_shape,
    interval,
    loud,
    plain,
    simplest,
    told_from_none,
)
from experiments.measurement.selection.choice import Judge
from experiments.measurement.selection.finalists import Round, at_other_joints
from experiments.measurement.selection.ladder import Rung, Selection
from experiments.measurement.selection.linear_score import Scored
from experiments.measurement.selection.pruning import take_out_idle, take_out_needless, take_out_unsure
from experiments.measurement.selection.select import _promises, stands_out
from mjx_starleth.names import JOINT_NAMES

NOISE, BEFORE = 1000.0, 9000.0  # chi^2 of noise alone, and without any effect


def finalist(name: str, where: str, held_out: float) -> Finalist:
    return Finalist(Scored(LIBRARY[name], where, 0.0, {}, None), None, held_out)


def named(*finalists: Finalist) -> tuple[str, list[str]]:
    winner, rivals = simplest(sorted(finalists, key=lambda f: f.held_out), BEFORE, NOISE, JOINT_NAMES)
    return winner.scored.where, [f.scored.where for f in rivals]


def test_an_interval_holds_what_the_log_tells_and_the_models_own_error() -> None:
    fit = Refitted((), np.zeros(0), np.zeros(0), (), (), np.diag([1e-6, 0.0]))
    low, high = interval(fit, 0, 0.0)
    assert (low, high) == pytest.approx((-1.96e-3, 1.96e-3))
    low, high = interval(fit, 1, 4.0)  # surer than the model is right: two percent to each side
    assert (low, high) == pytest.approx((4.0 * 0.9804, 4.0 * 1.0196))


def test_joints_that_do_not_feel_an_effect_are_not_named_with_it() -> None:
    assert named(finalist("backlash", "LH", 1050.0), finalist("backlash", "LH_HFE", 1051.0)) == ("LH_HFE", [])


def test_joints_that_feel_it_are() -> None:
    assert named(finalist("backlash", "LH", 1050.0), finalist("backlash", "LH_HFE", 1300.0)) == ("LH", [])


def test_another_effect_that_fits_as_well_is_a_rival_unless_it_has_more_parameters() -> None:
    one, other = finalist("coulomb_friction", "HFE", 1050.0), finalist("load_friction", "all", 1060.0)
    assert named(one, other) == ("HFE", ["all"])
    assert named(one, finalist("stribeck_friction", "all", 1045.0)) == ("HFE", [])


def test_a_weak_effect_is_not_given_up_for_a_simpler_one_because_the_noise_was_taken_too_large() -> None:
    load, links = finalist("payload", "torso", 52500.0), finalist("link_mass", "HAA", 52900.0)
    winner, rivals = simplest([load, links], 53800.0, 53300.0, JOINT_NAMES)
    assert winner.scored.effect.name == "payload" and rivals == []
    nearer = finalist("link_mass", "HAA", 52700.0)  # explains a sixth less: no rounding
    assert simplest([load, nearer], 53800.0, 53300.0, JOINT_NAMES)[0].scored.effect.name == "payload"
    alike = finalist("link_mass", "HAA", 52600.0)
    winner, _ = simplest([load, alike], 63800.0, 53300.0, JOINT_NAMES)  # a strong one explains the log down to noise
    assert winner.scored.effect.name == "link_mass"
    assert simplest([load, links], 63800.0, 53300.0, JOINT_NAMES)[0].scored.effect.name == "payload"


def drives(share: float) -> Part:
    """Twelve drives on 100 rows of one block, each row worth a share of one."""
    used, joint = np.full((100, 12, 3), share), np.arange(12)[:, None]
    return Part("drive", np.full((12, 3), "a channel"), joint, used, np.zeros(100, int), FELT_BY_DRIVES)


@pytest.mark.parametrize(
    ("name", "where", "gain", "tried"),
    [
        ("backlash", "LH_KFE", 310.0, True),
        ("backlash", "LH_KFE", 290.0, False),
        ("backlash", "all", 310.0, False),
        ("ground_friction", "feet", 310.0, True),
        ("torque_sensor_offset", "all", 370.0, False),
    ],
)
def test_a_score_is_held_against_the_noise_of_the_parts_where_it_acts(
    name: str, where: str, gain: float, tried: bool
) -> None:
    body = replace(drives(0.0), name="body", used=np.ones((100, 10)), felt=FELT_BY_BODIES, coupled=True)
    parts = (drives(12000 / 3600), body)
    log = SimpleNamespace(blocks=1, parts=parts, atoms=SimpleNamespace(joint_names=JOINT_NAMES))
    assert stands_out([Scored(LIBRARY[name], where, gain, {}, None)], [log]) == tried


def done(monkeypatch: pytest.MonkeyPatch, excess: float, found: tuple[str, ...] = ()) -> list[str]:
    """What a round does that finds nothing, beside effects found, in a log that leaves much above its floor."""
    did: list[str] = []
    ranking = [Scored(LIBRARY[name], "all", 900.0, {}, None) for name in ("backlash", "payload")]
    round_ = SimpleNamespace(refitted=lambda fit, ranking: did.append("refitted") or [], test=[])
    stubs = {"_scored": lambda *_: did.append("scored") or (ranking, round_), "excess": lambda *_: excess}
    stubs |= {"weight_of": lambda *_: 0.0, "all_blocks": lambda *_: []}
    stubs |= {"leaves_more": lambda *_: True, "stands_out": lambda *_: False, "at_other_joints": lambda *_: []}
    for name, stub in stubs.items():
        monkeypatch.setattr(select, name, stub)
    fit = SimpleNamespace(effects=found, total=0.0)
    selection = SimpleNamespace(
        fit=fit, ladder=[Rung("nominal model", fit, fit)], refitted=[], refuted=[], elsewhere=None
    )
    log = SimpleNamespace(blocks=1, atoms=SimpleNamespace(joint_names=JOINT_NAMES))
    assert select._next([log], selection, 0.02, 0.0, lambda text: None) is None
    return did


def test_in_a_log_that_is_explained_one_effect_is_refitted_and_only_if_it_stands_alone(monkeypatch) -> None:
    monkeypatch.setattr(select, "lone", lambda logs, fit, ranking, round_: [])
    assert done(monkeypatch, 0.03) == ["scored", "refitted"]
    assert done(monkeypatch, 0.01) == ["scored"]
    monkeypatch.setattr(select, "lone", lambda logs, fit, ranking, round_: ranking[:1])
    assert done(monkeypatch, 0.01) == ["scored", "refitted"]
    assert done(monkeypatch, 0.01, ("backlash",)) == []
    assert done(monkeypatch, 0.03, ("backlash",)) == ["scored", "refitted"]


@pytest.mark.parametrize(
    ("name", "values", "spread", "believed"),
    [
        ("coulomb_friction", {"torque": 0.004}, [0.001], True),
        ("coulomb_friction", {"torque": 0.004}, [0.003], False),
        ("stribeck_friction", {"torque": -0.004, "velocity": 0.2}, [0.001, 0.15], False),
        ("stribeck_friction", {"torque": -0.004, "velocity": 0.2}, [0.001, 0.02], True),
        ("constant_force", {"x": 0.1, "y": 20.0, "z": 0.1}, [1.0, 1.0, 1.0], True),
        ("payload", {"mass": 2.0, "x": 0.0, "y": 0.0, "z": 0.1}, [0.1, 0.02, 0.02, 0.2], True),
    ],
)
def test_an_effect_is_not_believed_whose_interval_holds_none(name, values, spread, believed) -> None:
    fit = Refitted((Placed(name, "all", values),), np.zeros(0), np.zeros(0), (), (), np.diag(np.square(spread)))
    assert told_from_none(LIBRARY[name], fit) == believed


@pytest.mark.parametrize(("velocity", "ended"), [(0.015, True), (3.0, True), (0.0191, False)])
def test_a_law_is_another_one_where_the_shape_that_makes_it_stands_at_its_end(velocity: float, ended: bool) -> None:
    placed = Placed("stribeck_friction", "KFE", {"torque": -0.003, "velocity": velocity})
    fit = Refitted((placed,), np.zeros(0), np.zeros(0), (), (), np.zeros((2, 2)))
    assert at_end_of_shape(LIBRARY["stribeck_friction"], fit) == ended
    earlier = placed._replace(parameters={"torque": -0.003, "velocity": 3.0 if not ended else 0.1})
    assert at_end_of_shape(LIBRARY["stribeck_friction"], replace(fit, effects=(earlier, placed))) == ended
    load = Placed("payload", "torso", {"mass": 2.0, "x": 0.4, "y": 0.0, "z": 0.0})  # on the torso's edge it is a load
    assert not at_end_of_shape(LIBRARY["payload"], replace(fit, effects=(load,)))


def test_an_effect_is_believed_of_whose_strengths_only_the_sum_is_known() -> None:
    delays = Placed("sensor_delay", "HFE", {"joint_side": 0.0022, "motor_side": 0.0024})
    apart = np.array([[1.0, -0.99], [-0.99, 1.0]]) * 0.003**2
    for covariance, believed in ((apart, True), (abs(apart), False)):
        fit = Refitted((delays,), np.zeros(0), np.zeros(0), (), (), covariance)
        assert told_from_none(LIBRARY["sensor_delay"], fit) == believed


def test_what_nothing_explains_at_some_joints_does_not_hide_the_others() -> None:
    places = ["LF_HFE", "HFE", "LH_HFE", "LF", "RH_KFE", "all"]
    ranking = [Scored(LIBRARY["backlash"], where, 100.0 - i, {}, None) for i, where in enumerate(places)]
    assert [s.where for s in at_other_joints(ranking, JOINT_NAMES)] == ["LH_HFE", "RH_KFE"]
    load = Scored(LIBRARY["payload"], "torso", 200.0, {}, None)
    assert at_other_joints([load, *ranking], JOINT_NAMES) == []


def one_loud_joint() -> tuple[SimpleNamespace, Refitted]:
    """A log whose 300 residuals at LF_HFE are 4500 above their noise together, and its fit without an effect."""
    residual = np.ones((100, 12, 3))
    residual[:, JOINT_NAMES.index("LF_HFE")] = 4.0
    rest = Rest(drives(1.0), residual, np.zeros((1, 1, 1)))
    log = SimpleNamespace(blocks=1, parts=(rest.part,), atoms=SimpleNamespace(joint_names=JOINT_NAMES))
    log.rests = lambda point: (rest,)
    log.weight = lambda: np.array([3600.0])
    return log, Refitted((), np.zeros(0), np.zeros(0), (None,), (np.array([8100.0]),), np.zeros((0, 0)))


@pytest.mark.parametrize(("where", "after", "believed"), [("LF_HFE", 5000.0, True), ("LF_HFE", 7900.0, False)])
def test_an_effect_that_explains_most_of_its_joints_misfit_needs_no_interval(where, after, believed) -> None:
    log, before = one_loud_joint()
    assert plain(LIBRARY["backlash"], where, before, after, [log], [np.ones(1, bool)]) == believed


@pytest.mark.parametrize(
    ("where", "spread", "after", "chosen"),
    [
        ("LF_HFE", 0.001, 6900.0, (True,)),  # told from none
        ("LF_HFE", 0.02, 6900.0, (False,)),  # blurred by what is left there, to be told later
        ("LF_HFE", 0.02, 7900.0, ()),  # explains too little of it
        ("all", 0.02, 6900.0, (False,)),
        ("RH", 0.02, 7300.0, ()),  # nothing is left there
    ],
)
def test_an_effect_may_wait_to_be_told_from_none_where_much_is_left(where, spread, after, chosen) -> None:
    log, before = one_loud_joint()
    assert loud(LIBRARY["backlash"], where, before, [log], [np.ones(1, bool)]) == (where != "RH")
    effects = (Placed("backlash", where, {"half_width": 0.01}),)
    fit = Refitted(effects, np.zeros(0), np.zeros(0), (None,), (np.array([after]),), np.array([[spread**2]]))
    one = Finalist(Scored(LIBRARY["backlash"], where, 0.0, {}, None), fit, after)
    judge = Judge([log], before, [np.ones(1, bool)], SimpleNamespace(refutes=lambda effects, fit: None), [])
    choice = judge.choice([one])
    assert (() if choice is None else (choice.sure,)) == chosen


@pytest.mark.parametrize(("velocity", "chosen"), [(0.1, True), (3.0, False)])
def test_a_law_whose_shape_stands_at_its_end_is_not_chosen_however_much_it_explains(velocity, chosen) -> None:
    log, before = one_loud_joint()
    effects = (Placed("stribeck_friction", "LF_HFE", {"torque": -0.004, "velocity": velocity}),)
    fit = Refitted(effects, np.zeros(0), np.zeros(0), (None,), (np.array([5000.0]),), 1e-8 * np.eye(2))
    one = Finalist(Scored(LIBRARY["stribeck_friction"], "LF_HFE", 0.0, {}, None), fit, 5000.0)
    judge = Judge([log], before, [np.ones(1, bool)], SimpleNamespace(refutes=lambda effects, fit: None), [])
    assert (judge.choice([one]) is not None) == chosen


@pytest.mark.parametrize(("rival", "sure"), [(100.0, True), (1000.0, False)])
def test_an_effect_that_no_other_comes_near_is_told_whatever_its_interval(rival: float, sure: bool) -> None:
    log, before = one_loud_joint()

    def refitted(name: str, gain: float, after: float) -> Finalist:
        effects = (Placed(name, "all", {LIBRARY[name].parameters[0].name: 0.01}),)
        chi2 = (np.array([after]),)
        fit = Refitted(effects, np.zeros(0), np.zeros(0), (None,), chi2, np.array([[0.02**2]]))
        return Finalist(Scored(LIBRARY[name], "all", gain, {}, None), fit, after)

    judge = Judge([log], before, [np.ones(1, bool)], SimpleNamespace(refutes=lambda effects, fit: None), [])
    choice = judge.choice([refitted("backlash", 3000.0, 5500.0), refitted("command_delay", rival, 8090.0)])
    assert choice.winner.scored.effect.name == "backlash" and choice.sure == sure


@pytest.mark.parametrize(("after", "stays"), [(900.0, False), (1100.0, True)])
def test_nominal_numbers_stay_where_following_the_score_takes_a_fit_farther_off(monkeypatch, after, stays) -> None:
    def fit_at(nominal: np.ndarray, chi2: float) -> Refitted:
        return Refitted((), nominal, nominal, (), (np.array([chi2]),), np.zeros((0, 0)))

    astray, here = np.ones(1), fit_at(np.zeros(1), 1000.0)
    monkeypatch.setattr(finalists, "following", lambda *args: astray)
    beside = lambda self, fit, scored, nominal: Finalist(scored, fit_at(nominal, after if nominal[0] else 950.0), 0.0)  # noqa: E731
    monkeypatch.setattr(Round, "_beside", beside)
    round_ = Round([], (), [], [], [np.ones(1, bool)], [], print)
    found = round_._refitted(here, Scored(LIBRARY["backlash"], "all", 1.0, {}, None))
    assert (found.fit.nominal[0] == 0.0) == stays


def test_only_of_sharp_effects_plausible_strengths_are_tried_beside_the_scores() -> None:
    log = SimpleNamespace(atoms=SimpleNamespace(effects=tuple(LIBRARY.values())))
    late = _plausible(log, Placed("sensor_delay", "all", {"joint_side": 0.0, "motor_side": 0.0}))
    assert [placed.parameters["motor_side"] for placed in late] == [
        pytest.approx(size * 0.002) for size in (0.3, 0.6, 1.0, 1.5, 2.0, 3.0)
    ]
    assert _plausible(log, Placed("coulomb_friction", "all", {"torque": 0.01})) == []


def test_an_effect_begins_where_another_fit_has_it_and_is_told_as_it_scored(monkeypatch) -> None:
    scored = [Scored(LIBRARY["backlash"], where, 9.0, {"half_width": 0.1}, None) for where in ("KFE", "LF")]
    fit = Refitted((), np.zeros(0), np.zeros(0), (None,), (), np.zeros((0, 0)))
    stubs = {"changes_of": lambda *_: ([], []), "halves": lambda _: ((), ()), "scored_at": lambda *_: scored}
    for name, stub in stubs.items():
        monkeypatch.setattr(select, name, stub)
    log = SimpleNamespace(atoms=SimpleNamespace(effects=()), products=lambda *_: None)
    selection = Selection(fit, (), None, begin=(Placed("backlash", "KFE", {"half_width": 0.02}),))
    rung = Rung("", fit, fit)
    assert select.select([log], (), print, most=0, begun=rung, begin=selection.begin).begin == selection.begin
    begun, _ = select._scored([log], selection, lambda _: None)
    assert [one.values["half_width"] for one in begun] == [0.02, 0.1]
    assert selection.rankings == [scored]


@pytest.mark.parametrize(("spread", "kept"), [((0.001, 0.1), 2), ((0.2, 0.01), 0)])
def test_an_effect_that_no_later_one_has_helped_to_tell_from_none_is_taken_back(spread, kept) -> None:
    placed = (Placed("backlash", "HFE", {"half_width": 0.01}), Placed("torque_constant", "all", {"relative": 0.2}))
    fits = [Refitted(placed[:n], np.zeros(0), np.zeros(0), (), (), np.diag(np.square(spread[:n]))) for n in range(3)]
    log = SimpleNamespace(atoms=SimpleNamespace(effects=(LIBRARY["backlash"], LIBRARY["torque_constant"])))
    selection = Selection(fits[2], (), SimpleNamespace(logs=[log]), ladder=[Rung("", fit, fit) for fit in fits])
    selection.ties, selection.winners, selection.rivals = [[], []], fits[1:], [[], []]
    selection.sure = [False, True]
    take_out_unsure(selection)
    assert len(selection.fit.effects) == len(selection.ties) == len(selection.winners) == kept
    assert len(selection.ladder) == kept + 1


@pytest.mark.parametrize(("spread", "without", "kept"), [(3e-3, 8120.0, 1), (1e-4, 8120.0, 2), (3e-3, 9500.0, 2)])
def test_an_effect_that_the_whole_fit_neither_tells_from_none_nor_needs_is_taken_out(
    monkeypatch, spread: float, without: float, kept: int
) -> None:
    log, before = one_loud_joint()
    log.atoms.effects = (LIBRARY["backlash"], LIBRARY["coulomb_friction"])
    play = Placed("backlash", "LF_HFE", {"half_width": 0.02})
    friction = Placed("coulomb_friction", "all", {"torque": 4e-3})
    fit = replace(before, effects=(play, friction), covariance=np.diag([1e-8, spread**2]))
    fitted = replace(fit, effects=(play,), chi2=(np.array([without]),), covariance=np.diag([1e-8]))
    monkeypatch.setattr("experiments.measurement.selection.pruning.refit", lambda *_: fitted)
    ladder = [Rung("", before, before), Rung("", fitted, fitted), Rung("", fit, fit)]
    selection = Selection(fit, (), None, ladder, ties=[[], []], winners=[fit] * 2, rivals=[[], []], sure=[True, True])
    take_out_idle(selection, [log], [np.ones(1, bool)])
    assert len(selection.fit.effects) == kept == len(selection.ties) == len(selection.ladder) - 1


def test_what_is_left_after_an_effect_was_taken_out_is_judged_without_it(monkeypatch) -> None:
    log, before = one_loud_joint()
    names = ("viscous_friction", "coulomb_friction", "backlash")
    log.atoms.effects = tuple(LIBRARY[name] for name in names)
    fits = [replace(before, effects=tuple(Placed(name, "all", {}) for name in names[:n])) for n in range(4)]
    asked = []

    def fitted(_, effects, *__):
        asked.append(tuple(placed.effect for placed in effects))
        return replace(before, effects=tuple(effects))

    monkeypatch.setattr("experiments.measurement.selection.pruning.refit", fitted)
    needed = lambda effect, *_: effect.name != "coulomb_friction"  # noqa: E731
    monkeypatch.setattr("experiments.measurement.selection.pruning.proven", needed)
    kept = {"ties": [[]] * 3, "winners": fits[1:], "rivals": [[]] * 3, "sure": [True] * 3}
    selection = Selection(fits[3], (), None, [Rung("", fit, fit) for fit in fits], **kept)
    blocks = [np.ones(1, bool)]
    take_out_needless(selection, [log], blocks, blocks)
    assert [placed.effect for placed in selection.fit.effects] == ["viscous_friction", "backlash"]
    assert asked[-1] == ("backlash",)


@pytest.mark.parametrize(("scores", "tried"), [((60.0, 40.0), True), ((30.0, 20.0), False), ((30.0, 7.0), True)])
def test_what_is_far_above_all_others_is_tried_whatever_its_score_promises(scores, tried: bool) -> None:
    effects = LIBRARY["sensor_delay"], LIBRARY["backlash"]
    ranking = [Scored(effect, "all", gain, {}, None) for effect, gain in zip(effects, scores, strict=True)]
    assert _promises(ranking, 50.0) == tried


def test_feet_that_slide_for_a_few_rows_each_count_together() -> None:
    channels = ("torso_force/x", "link_torque/LF_HAA", "friction/LF", "friction/RF", "friction/LH")
    assert enough(channels, np.array([500, 19, 13, 8, 0]), FEWEST).tolist() == [True, False, True, True, False]
    assert not enough(channels, np.array([500, 19, 13, 6, 0]), FEWEST)[2:].any()


@pytest.mark.parametrize(
    ("left", "share", "verdict"),
    [(16.0, 0.16, "unknown"), (16.0, 0.04, "partly_explained"), (3.0, 0.16, "partly_explained"), (3.0, 0.4, "unknown")],
)
def test_a_loud_rest_that_is_no_small_share_has_another_law(monkeypatch, left, share, verdict) -> None:
    monkeypatch.setattr(verdicts, "worst", lambda logs, fit: left)
    monkeypatch.setattr(verdicts, "unexplained", lambda logs, selection: share)
    fit = SimpleNamespace(effects=(Placed("torque_constant", "RF_HFE", {"relative": -0.3}),))
    assert verdicts.decide([SimpleNamespace(rigid=False)], SimpleNamespace(fit=fit, ties=[[]], ladder=[]))[0] == verdict


@pytest.mark.parametrize(
    ("name", "where", "tried"),
    [("sensor_delay", "HFE", True), ("sensor_delay", "LF_HFE", False), ("sensor_delay", "all", False)],
)
def test_an_effect_of_a_kind_of_joint_is_tried_at_all_of_them(name: str, where: str, tried: bool) -> None:
    log = SimpleNamespace(atoms=SimpleNamespace(joint_names=JOINT_NAMES))
    round_ = Round([log], (), [], [], [], [], print)
    best = Scored(LIBRARY[name], where, 1.0, {}, None)
    assert round_._may_be_everywhere(best, ()) == tried
    assert not round_._may_be_everywhere(best, (Placed(name, "all", {}),))
