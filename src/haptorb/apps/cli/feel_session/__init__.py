"""What `haptorb feel` joins: designs, servo, console, terminal, and the limits of the gain."""
