"""Whether a resumed run would try the values that it has stored."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from haptorb.design.evaluation import Evaluation, Value
from haptorb.errors import RecordingError

__all__ = ["check_values"]


def check_values(wanted: Mapping[int, Mapping[str, Value]], stored: Iterable[Evaluation]) -> None:
    """RecordingError unless each stored candidate has the values that its number stands for now."""
    for one in stored:
        for name, value in wanted[one.number].items():
            if one.values.get(name) != value:
                raise RecordingError(
                    f"candidate {one.number} of the results has {name} = {one.values.get(name)}, this program "
                    f"computes {value}: another version of haptorb, NumPy, SciPy or pymoo wrote them; use another "
                    "--seed, or another results file"
                )
