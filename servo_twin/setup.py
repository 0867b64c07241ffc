"""Build of the ROS package servo_twin, with colcon or with pip."""

import os
from glob import glob

from setuptools import find_packages, setup

PACKAGE = "servo_twin"
SHARE = f"share/{PACKAGE}"

# Boards and levels that are compiled, as functions of the build script. `make` compiles each by itself, while the
# packages are installed.
MODULES = os.environ.get("SERVO_TWIN_MODULES", "ffi registers_ffi odrive36_ffi odrive36_ideal_ffi").split()

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Virtual board, digital twin and viewer of the servo",
    license="Apache-2.0",
    author="servo contributors",
    maintainer="servo contributors",
    maintainer_email="maintainers@servo.example",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    # Spelt out, an editable install is a plain path entry. The import hook that setuptools writes otherwise loses to
    # the folder of the same name when the current directory is the root of the repository.
    package_dir={"": "."},
    package_data={"": ["*.toml", "examples/*.xml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/launch", sorted(glob("launch/*.launch.py"))),
        (f"{SHARE}/config", sorted(glob("config/*.yaml"))),
        # pip puts console scripts into bin/, where `ros2 run` and launch do not look.
        (f"lib/{PACKAGE}", sorted(glob("scripts/*"))),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["cffi", "numpy", "pycparser", "scipy", "servo_msgs_py", "tqdm", 'tomli; python_version < "3.11"'],
    extras_require={
        "ros": ["servo_msgs_py[ros]"],
        "test": ["pytest", "hypothesis"],
        # servo-sim --scheduler: trials on a cluster.
        "cluster": ["distributed"],
        # servo-sim robot, servo_twin.robot; there is no MuJoCo 4 for Python 3.10.
        "mujoco": ['mujoco>=4; python_version >= "3.11"'],
        # servo_twin.vector_env.
        "gymnasium": ["gymnasium>=1"],
        # servo-twin export --format parquet, servo-sim sweep --parquet; rerun needs it, too.
        "parquet": ["pyarrow"],
        # servo-sim tune-robust.
        "tune": ["optuna>=5"],
        # The nodes and experiments run without; there is no rerun for Python 3.10.
        "viewer": ["matplotlib", 'rerun-sdk==0.41.*; python_version >= "3.11"'],
    },
    cffi_modules=[f"servo_twin/_build_native.py:{module}" for module in MODULES],
    # Not console scripts: Ctrl-C in the start of Python would print a traceback.
    scripts=sorted(glob("scripts/*")),
)
