"""Refinement of a prediction on its own picture (Eq. 6)."""

from learn.refinement.descent import Refined, refine
from learn.refinement.settings import NAMED, PAPER, Settings

__all__ = ["NAMED", "PAPER", "Refined", "Settings", "refine"]
