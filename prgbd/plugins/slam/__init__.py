"""SLAM systems that come with prgbd."""
