"""Everything but one thing stands in pyproject.toml: the folder conf/ is the package prgbd.conf."""

from setuptools import find_namespace_packages, setup

configuration = ["prgbd.conf", *(f"prgbd.conf.{group}" for group in find_namespace_packages("conf"))]
packages = find_namespace_packages(include=["prgbd", "prgbd.*"])
setup(packages=packages + configuration, package_dir={"prgbd.conf": "conf"})
