"""The design loop of Bai 2012, Fig. 5(a): candidate designs from a file are felt, rated, compared and selected."""

from haptorb_study.feel.course import InsertionForces, course
from haptorb_study.feel.designs import Candidate, Candidates, load_designs
from haptorb_study.feel.records import Choice, DesignRating
from haptorb_study.feel.session import FeelSession
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
