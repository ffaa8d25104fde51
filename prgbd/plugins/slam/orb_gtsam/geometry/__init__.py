"""Geometry without a map: Lie groups, similarities, two views and all motions they allow, triangulation kernels.

Pure functions on arrays, most of them compiled.
"""
