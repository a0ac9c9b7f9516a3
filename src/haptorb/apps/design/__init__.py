"""`haptorb design`: a sweep or optimisation as people see it, the report of its results, and the chooser."""
