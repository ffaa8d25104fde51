"""The tasks; each module has ``run(job)``."""
