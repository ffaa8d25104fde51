"""The loss terms that come with prgbd: P, S, D and T of the method."""
