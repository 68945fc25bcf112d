from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=["vb_sim", "vb_sim.cameras", "vb_sim.person", "vb_sim.robot", "vb_sim.room"], package_dir={"": "src"}
    )
)
