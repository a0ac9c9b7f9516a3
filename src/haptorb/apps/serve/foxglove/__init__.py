"""`haptorb run --serve foxglove`: a live view of the device in Foxglove."""
