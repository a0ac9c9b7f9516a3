"""Search for devices: design files, evaluation of candidates, sweeps, optimisation, and their results.

>>> from pathlib import Path
>>> from haptorb_design import evaluate_candidate, parse_design
>>> design = parse_design('''
... name = "smaller-core"
... base = "omni"
... [parameters.core_radius]
... low = "10 mm"
... high = "15 mm"
... places = ["electromagnet.core_radius"]
... [objectives.core_pull]
... ''', "smaller-core.toml", Path())
>>> small, large = (evaluate_candidate(design, n, {"core_radius": r}) for n, r in enumerate((12.0, 15.0)))
>>> small.valid, small.objectives["core_pull"] < large.objectives["core_pull"]
(True, True)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb_design.design_file import load_design, parse_design
    from haptorb_design.evaluate import evaluate as evaluate_candidate
    from haptorb_design.problem import Design, DesignCandidate, Evaluation, write_device_text
    from haptorb_design.sampling import sample as sample_parameters
    from haptorb_design.sampling import sweep
    from haptorb_design.store import Results, ResultsWriter, open_results, read_results
    from haptorb_design.workers import open_workers

__all__ = [
    "Design",
    "DesignCandidate",
    "Evaluation",
    "Results",
    "ResultsWriter",
    "evaluate_candidate",
    "load_design",
    "open_results",
    "open_workers",
    "parse_design",
    "read_results",
    "sample_parameters",
    "sweep",
    "write_device_text",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb_design.design_file": "load_design parse_design",
        "haptorb_design.evaluate": "evaluate>evaluate_candidate",
        "haptorb_design.problem": "Design DesignCandidate Evaluation write_device_text",
        "haptorb_design.sampling": "sample>sample_parameters sweep",
        "haptorb_design.store": "Results ResultsWriter open_results read_results",
        "haptorb_design.workers": "open_workers",
    },
)
