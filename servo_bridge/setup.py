"""Build of the ROS package servo_bridge, with colcon or with pip."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = "servo_bridge"
SHARE = f"share/{PACKAGE}"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="ROS 2 node and command line for the servo board on a serial port",
    license="Apache-2.0",
    author="servo contributors",
    maintainer="servo contributors",
    maintainer_email="maintainers@servo.example",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    # Written explicitly, an editable install is a plain path entry. The import hook of setuptools would be overridden
    # by the folder of the same name if the current directory is the root of the repository.
    package_dir={"": "."},
    package_data={"": ["*.toml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"{SHARE}/config", sorted(glob("config/*.yaml"))),
        (f"{SHARE}/urdf", sorted(glob("urdf/*.urdf"))),
        # pip installs console scripts to bin/, where `ros2 run` and launch do not search.
        (f"lib/{PACKAGE}", sorted(glob("scripts/*"))),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["numpy", "pyserial>=3.5", "servo_msgs_py", "tqdm"],
    extras_require={
        "completion": ["argcomplete"],  # of servo-command in the shell
        "plot": ["matplotlib"],
        "ros": ["servo_msgs_py[ros]"],
        "test": ["pytest", "hypothesis"],
        # For recordings of servo-tool; rerun does not support Python 3.10.
        "viewer": ["matplotlib", 'rerun-sdk==0.41.*; python_version >= "3.11"'],
    },
    # Not console scripts: Ctrl-C in the start of Python would print a traceback.
    scripts=sorted(glob("scripts/*")),
)
