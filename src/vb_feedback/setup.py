from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=["vb_feedback", "vb_feedback.display", "vb_feedback.projector", "vb_feedback.sound"],
        package_dir={"": "src"},
    )
)
