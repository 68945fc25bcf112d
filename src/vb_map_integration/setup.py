from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=[
            "vb_map_integration",
            "vb_map_integration.borders",
            "vb_map_integration.grid",
            "vb_map_integration.places",
            "vb_map_integration.storage",
        ],
        package_dir={"": "src"},
    )
)
