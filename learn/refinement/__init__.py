"""Refinement of a prediction on its own picture (Eq. 6)."""

from learn.refinement.descent import RefinementResult, refine
from learn.refinement.settings import NAMED, PAPER, PHOTOGRAPHS, RefinementSettings

__all__ = ["NAMED", "PAPER", "PHOTOGRAPHS", "RefinementResult", "RefinementSettings", "refine"]
