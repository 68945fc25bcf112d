from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=["vb_robot", "vb_robot.dispatching", "vb_robot.driving"], package_dir={"": "src"}
    )
)
