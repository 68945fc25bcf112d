from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=[
            "vb_laser_detect",
            "vb_laser_detect.calibration",
            "vb_laser_detect.camera",
            "vb_laser_detect.detection",
        ],
        package_dir={"": "src"},
    )
)
