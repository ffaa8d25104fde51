"""When an observation agrees with a point: the limits of the chi-square test."""

from __future__ import annotations

# 95 % limits of two and three degrees of freedom (ORB-SLAM2, Optimizer): a pixel, and a pixel with its right column.
CHI2_MONO = 5.991
CHI2_STEREO = 7.815
