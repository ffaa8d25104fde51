"""Data plug-ins: recordings on disk and the synthetic world."""
