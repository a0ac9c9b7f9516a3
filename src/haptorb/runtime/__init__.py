"""Run time: loop, servo and its processes, drivers and trackers; only from this layer up are clocks and I/O used."""
