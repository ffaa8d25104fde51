"""The augmentations that come with prgbd."""
