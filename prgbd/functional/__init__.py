"""Differentiable functions of images, depth and motion: warping, similarity, losses, colour.

They hold no state and no options, so loss terms and augmentations of any package, pre-training and the evidence of the
loop share them.
"""
