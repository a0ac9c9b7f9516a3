"""Perceptual studies on the dome: trials, storage, analysis and rehearsal.

From a study file (TOML) to the tables a paper needs. Every answer is durable before the next trial begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb_study.analysis.analysis import Analysis, analysis_of
    from haptorb_study.feel.designs import Candidate as FeelDesign
    from haptorb_study.feel.designs import Candidates as FeelDesigns
    from haptorb_study.feel.designs import load_designs

__all__ = ["Analysis", "FeelDesign", "FeelDesigns", "analysis_of", "load_designs"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb_study.analysis.analysis": "Analysis analysis_of",
        "haptorb_study.feel.designs": "Candidate>FeelDesign Candidates>FeelDesigns load_designs",
    },
)
