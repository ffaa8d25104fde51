"""The criteria that come with prgbd: what decides whether a loop made things better."""
