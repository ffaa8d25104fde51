"""The contract: everything a plug-in author reads, and nothing that is heavy to import."""
