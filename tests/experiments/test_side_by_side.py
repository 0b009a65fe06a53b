"""Fits on several threads: replays are remembered once, devices take turns, results come in the order of the items."""

import threading
from pathlib import Path

import jax
import numpy as np
import pytest

from experiments.effects.library import LIBRARY
from experiments.measurement.evidence import remembered, turns
from experiments.measurement.evidence.gather import gather
from experiments.measurement.evidence.remembered import Remembered
from experiments.measurement.fits import side_by_side as module
from experiments.measurement.fits.side_by_side import side_by_side
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.model import nominal_model

AIR = Path(__file__).parents[1] / "data" / "air_reference_1500ms.csv.gz"
LONG = 30.0  # s that no test waits for unless it fails


class Squares:
    """What replays are to a memory, and how many were run."""

    def __init__(self, keys):
        self.keys, self.run_for = np.asarray(keys, float)[:, None], []

    def __call__(self, new):
        self.run_for += self.keys[new, 0].tolist()
        return self.keys[new] ** 2


def _asked(memory, keys):
    squares = Squares(keys)
    return memory.ask(squares.keys, squares)[:, 0].tolist(), squares.run_for


def test_only_new_numbers_are_replayed_and_results_keep_their_order():
    memory = Remembered()
    assert _asked(memory, [3.0, 1.0, 3.0]) == ([9.0, 1.0, 9.0], [3.0, 1.0])
    assert _asked(memory, [1.0, 2.0]) == ([1.0, 4.0], [2.0])


def test_what_was_asked_for_longest_ago_is_forgotten(monkeypatch):
    monkeypatch.setattr(remembered, "MOST", 2)
    memory = Remembered()
    _asked(memory, [1.0, 2.0])
    _asked(memory, [1.0])
    _asked(memory, [3.0])
    assert _asked(memory, [1.0])[1] == []
    assert _asked(memory, [2.0])[1] == [2.0]
    # more at once than are kept
    assert _asked(memory, [4.0, 5.0, 6.0])[0] == [16.0, 25.0, 36.0]


def test_a_replay_that_takes_long_holds_up_no_other():
    memory, begun, go_on = Remembered(), threading.Event(), threading.Event()

    def slow(new):
        begun.set()
        assert go_on.wait(LONG)
        return np.full((len(new), 1), 1.0)

    thread = threading.Thread(target=memory.ask, args=(np.ones((1, 1)), slow))
    thread.start()
    assert begun.wait(LONG)
    assert _asked(memory, [2.0]) == ([4.0], [2.0])
    go_on.set()
    thread.join(LONG)
    assert _asked(memory, [1.0, 2.0]) == ([1.0, 4.0], [])


def test_replays_begin_on_another_device_each_time(monkeypatch):
    found = turns.replay_devices()
    assert 1 <= len(found) <= len(jax.local_devices())
    monkeypatch.setattr(turns, "replay_devices", lambda: ["first", "second"])
    one, other = turns.next_devices(1), turns.next_devices(5)
    assert len(one) == 1 and sorted(other) == ["first", "second"]
    assert other[0] != one[0]


@pytest.fixture
def two_devices(monkeypatch):
    monkeypatch.setattr(module, "replay_devices", lambda: ["first", "second"])


def test_fits_run_at_the_same_time_and_come_in_order(two_devices):
    meet = threading.Barrier(2, timeout=LONG)  # passes only if two are there at once
    assert side_by_side(lambda item: (meet.wait(), item)[1], [3, 1, 2, 4]) == [3, 1, 2, 4]


def test_an_error_of_a_fit_is_raised(two_devices):
    def fit(item):
        if item == 2:
            raise ValueError("no such effect")
        return item

    with pytest.raises(ValueError, match="no such effect"):
        side_by_side(fit, [1, 2, 3])


def test_a_replay_is_the_same_to_the_bit_alone_and_among_others():
    """Else what a diagnosis finds would hang on which thread asked first."""
    log, effects = read_log(AIR), {name: LIBRARY[name] for name in ("stribeck_friction", "torque_ripple", "backlash")}
    drive = gather(log, nominal_model(), effects, noise_of(log)).drive
    xs = np.abs(np.random.default_rng(0).normal(0.0, 1e-3, (9, drive.atoms.size)))
    shifts = np.zeros((9, 12))
    together = drive.predict(xs, shifts)
    assert np.isfinite(together).all() and np.ptp(together, axis=0).max() > 0
    for k in range(9):
        np.testing.assert_array_equal(drive.predict(xs[k : k + 1], shifts[:1])[0], together[k])
