"""Search for parameters: named space, CMA-ES with bounds, stages, checkpoints, gradient refinement. Knows no robot."""

from es.checkpoint import Checkpointer, CheckpointError
from es.progress import Generation, Progress
from es.refine import Descent, Refined, RefineSettings, refine
from es.result import SearchFailed, SearchResult, StageResult
from es.risk import Risk, reduce_costs
from es.search import SearchInterrupted, SearchSettings, search
from es.space import Parameter, ParameterSpace
from es.stages import Stage

__all__ = [
    "CheckpointError",
    "Checkpointer",
    "Descent",
    "Generation",
    "Parameter",
    "ParameterSpace",
    "Progress",
    "RefineSettings",
    "Refined",
    "Risk",
    "SearchFailed",
    "SearchInterrupted",
    "SearchResult",
    "SearchSettings",
    "Stage",
    "StageResult",
    "reduce_costs",
    "refine",
    "search",
]
