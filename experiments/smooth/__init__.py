"""The closed loop with every law rounded, so that costs have slopes: for refinement by gradients."""

from experiments.smooth.laws import WIDTHS, Widths
from experiments.smooth.rollout import SmoothEvaluation, cost_and_slope, smooth_rollout

__all__ = ["WIDTHS", "SmoothEvaluation", "Widths", "cost_and_slope", "smooth_rollout"]
