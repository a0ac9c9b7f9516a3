"""The design loop of Bai 2012, Fig. 5(a): candidate designs from a file, felt one by one, rated, compared, chosen."""

from haptorb.apps.feel.candidates import Candidate, Candidates, load_designs
from haptorb.apps.feel.course import InsertionForces, course
from haptorb.apps.feel.session import Choice, DesignRating, FeelSession, Trace

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
