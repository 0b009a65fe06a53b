"""All that one log says about the plant, in one currency, residual over noise: what every log's evidence can be asked.

There are two kinds, `RobotEvidence` of series-elastic drives and the bodies that they move, and `JointEvidence` of a
rigid joint on a bench. Fits, selection and verdict are written once, for both.
"""

from typing import NamedTuple, Protocol

import numpy as np

from experiments.measurement.evidence.atoms import Atoms
from experiments.measurement.evidence.body_evidence import BodyEvidence
from experiments.measurement.evidence.drive_evidence import DriveEvidence
from experiments.measurement.evidence.features import Change, Products, Seeds
from experiments.measurement.evidence.load_evidence import LoadEvidence
from experiments.measurement.evidence.parts import Part, Rest
from experiments.measurement.evidence.row_motion import Inputs, MeasuredMotion, RowMotion

Array = np.ndarray


class Point(NamedTuple):
    """Numbers at which the replay runs: atoms (n,), shift of the first motor angle (J,), channel offsets (C,)."""

    x: Array
    shift: Array
    offset: Array


class LocalPart(NamedTuple):
    """Columns near a point of one part of a log: what directions and the log's nuisances change, then the residual.

    columns (c, rows, …); index (c,): their places in a gram matrix; block (rows,).
    """

    columns: Array
    index: Array
    block: Array


class Evidence(Protocol):
    """One log's evidence. What it says of each of its parts comes in the order of `parts`."""

    @property
    def name(self) -> str: ...

    @property
    def atoms(self) -> Atoms: ...

    @property
    def blocks(self) -> int:
        """Number of BLOCKs."""

    @property
    def period(self) -> float:
        """Of the log's rows, s."""

    @property
    def model_x(self) -> Array:
        """The model's own effects (n,)."""

    @property
    def drive(self) -> DriveEvidence | None: ...

    @property
    def body(self) -> BodyEvidence | LoadEvidence | None: ...

    @property
    def rigid(self) -> bool:
        """Whether nothing but the effort's sensor is between the motor and the load: its gain is then all of the
        numbers in one, and other laws of position or speed may be imitated."""

    @property
    def standing(self) -> bool:
        """Whether the log shows the robot on the ground."""

    @property
    def not_judged(self) -> str:
        """What the log does not show, in one sentence; empty where it shows all."""

    @property
    def parts(self) -> tuple[Part, ...]: ...

    def rests(self, point: Point) -> tuple[Rest, ...]:
        """What a point leaves of each part."""

    def motions(self, point: Point) -> tuple[RowMotion, ...]:
        """The joints' motion on each part's rows."""

    def inputs(self, point: Point) -> tuple[Inputs, ...]:
        """What the rest of each part may go with."""

    def measured_motion(self) -> MeasuredMotion | None:
        """The joints' on the rows of the first part; None where that part is the bodies."""

    def start(self) -> Point:
        """Where every fit begins: the model's own effects, nothing else off."""

    def seeds_at(self, point: Point) -> Seeds:
        """Starts of shape parameters that what is left at a point brings."""

    def chi2(self, points: list[Point]) -> Array:
        """Sum of squared residuals, rows thinned to independent ones: (H, blocks)."""

    def weight(self) -> Array:
        """Expected chi^2 of noise alone per block (blocks,)."""

    def constant_errors(self, at: Point) -> Array:
        """What the channels' constant errors add to chi^2 beside the residuals, (blocks, C)."""

    def products(self, at: Point, changes: list[Change]) -> Products:
        """Inner products of the features of `changes`, of this log's own nuisances and of the residual at a point."""

    def local(self, at: Point, directions: Array) -> Array:
        """Gram matrices (blocks, c, c) of a few directions (k, n) at a point: directions, nuisances, residual."""

    def local_parts(self, at: Point, directions: Array) -> list[LocalPart]:
        """The same before products are taken, part by part."""

    def nuisances(self, z: Array) -> tuple[Array, Array]:
        """Coefficients of a gram's nuisance columns as changes of shifts (J,) and offsets (C,)."""

    def coefficients(self, at: Point) -> Array:
        """Where a point's shifts and offsets stand, in units of their priors: the inverse of `nuisances`."""
