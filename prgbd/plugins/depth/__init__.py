"""The depth networks that come with prgbd."""
