"""Everything but one thing stands in pyproject.toml: the folder conf/ is the package prgbd.conf."""

from setuptools import find_packages, setup

configuration = ["prgbd.conf"]
setup(packages=find_packages(include=["prgbd", "prgbd.*"]) + configuration, package_dir={"prgbd.conf": "conf"})
