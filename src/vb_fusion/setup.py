from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(**generate_distutils_setup(packages=["vb_fusion", "vb_fusion.line", "vb_fusion.stroke"], package_dir={"": "src"}))
