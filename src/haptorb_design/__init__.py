"""Search for devices: a design file, what is computed of each candidate, sweeps, optimisation, and their results.

>>> from pathlib import Path
>>> from haptorb_design.design_file import parse_design
>>> from haptorb_design.evaluate import evaluate
>>> design = parse_design('''
... name = "smaller-core"
... base = "omni"
... [parameters.core_radius]
... low = "10 mm"
... high = "15 mm"
... places = ["electromagnet.core_radius"]
... [objectives.core_pull]
... ''', "smaller-core.toml", Path())
>>> found = evaluate(design, 0, {"core_radius": 12.0})
>>> found.valid, found.objectives["core_pull"] < evaluate(design, 1, {"core_radius": 15.0}).objectives["core_pull"]
(True, True)
"""
