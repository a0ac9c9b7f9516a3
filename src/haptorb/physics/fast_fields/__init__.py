"""Fields and answers in a form that a servo can evaluate in each tick: tables and series."""
