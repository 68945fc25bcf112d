from setuptools import setup
from catkin_pkg.python_setup import generate_distutils_setup

setup(
    **generate_distutils_setup(
        packages=[
            "vb_evaluation",
            "vb_evaluation.study_kit",
            "vb_evaluation.demonstration",
            "vb_evaluation.report",
            "vb_evaluation.study",
            "vb_evaluation.virtual_ros",
        ],
        package_dir={"": "src"},
        package_data={"vb_evaluation.report": ["page.html.j2", "page.css"]},
    )
)
