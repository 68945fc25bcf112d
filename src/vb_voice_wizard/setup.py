from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=["vb_voice_wizard", "vb_voice_wizard.dialogue", "vb_voice_wizard.voice"], package_dir={"": "src"}
    )
)
