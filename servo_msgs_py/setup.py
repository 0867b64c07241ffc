"""Build of the ROS package servo_msgs_py, with colcon or with pip."""

from setuptools import find_packages, setup

PACKAGE = "servo_msgs_py"
SHARE = f"share/{PACKAGE}"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Contract of the servo; design of its control loops; measurements on a board",
    license="Apache-2.0",
    author="servo contributors",
    maintainer="servo contributors",
    maintainer_email="maintainers@servo.example",
    packages=find_packages(exclude=["test", "test.*"]),
    # Spelt out, an editable install is a plain path entry. The import hook that setuptools writes otherwise loses to
    # the folder of the same name when the current directory is the root of the repository.
    package_dir={"": "."},
    package_data={"": ["*.toml", "boards/*.toml", "*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["numpy", 'tomli; python_version < "3.11"'],
    extras_require={
        "plot": ["matplotlib"],
        # Recordings of runs (servo_msgs_py.run_file).
        "record": ["lz4", "mcap>=1.6", "rosbags>=0.11.9", "pyyaml", "zstandard"],
        # Only for machines without ROS 2: there these come as wheels.
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces", "pyyaml"],
        "test": ["pytest", "hypothesis"],
    },
)
