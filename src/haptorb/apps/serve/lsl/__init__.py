"""`haptorb run --serve lsl`: every row of the loop as a stream of the lab streaming layer."""
