from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=["vb_core", "vb_core.ros"], package_dir={"": "src"}, package_data={"vb_core": ["languages/*/*.yaml"]}
    )
)
