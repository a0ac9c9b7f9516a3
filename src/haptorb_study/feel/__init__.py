"""The design loop of Bai 2012, Fig. 5(a): candidate designs from a file are felt, rated, compared and selected."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb_study.feel.designs import Candidate, Candidates, load_designs
    from haptorb_study.feel.insertion_forces import InsertionForces, course
    from haptorb_study.feel.session import Choice, DesignRating, FeelSession
    from haptorb_study.feel.trace import Trace

__all__ = [
    "Candidate",
    "Candidates",
    "Choice",
    "DesignRating",
    "FeelSession",
    "InsertionForces",
    "Trace",
    "course",
    "load_designs",
]

# Every start of `haptorb` imports `feel.cli`, and the modules of these names import in seconds.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb_study.feel.designs": "Candidate Candidates load_designs",
        "haptorb_study.feel.insertion_forces": "InsertionForces course",
        "haptorb_study.feel.session": "Choice DesignRating FeelSession",
        "haptorb_study.feel.trace": "Trace",
    },
)
