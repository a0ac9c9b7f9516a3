"""The design loop of Bai 2012, Fig. 5(a): candidate designs from a file, felt one by one, rated, compared, chosen."""

from haptorb.apps.feel.candidates import Candidate, Candidates, load_designs
from haptorb.apps.feel.course import Course, course
from haptorb.apps.feel.session import Choice, Rating, Session, Trace

__all__ = [
    "Candidate",
    "Candidates",
    "Choice",
    "Course",
    "Rating",
    "Session",
    "Trace",
    "course",
    "load_designs",
]
