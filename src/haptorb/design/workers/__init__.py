"""Where candidates are computed: in this process, on its computer's cores, or on a cluster. All give the same."""
