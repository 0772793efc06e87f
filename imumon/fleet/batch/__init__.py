"""The same command over many sessions: one session one task, one table of all results."""
