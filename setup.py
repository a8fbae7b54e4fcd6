from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

package_name = "uuv_optical_array"
share = f"share/{package_name}"
NODES = ["simulator", "feature", "estimator", "formation", "follower", "vehicles", "view"]
CLUSTER = ["dask", "distributed", "zarr>=2.18"]
BAGS = ["rosbags>=0.10", "mcap>=1.2"]
HARDWARE = ["cobs", "pyserial"]
VIEW = ["viser>=1.1"]

setup(
    name=package_name,
    version="1.0.0",
    description="One underwater vehicle follows another by light",
    # `colcon build --symlink-install` runs a link to this file in another folder.
    long_description=Path(__file__).resolve().with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    project_urls={"Method": "https://doi.org/10.1109/JOE.2015.2389592"},
    keywords=["ROS 2", "underwater", "localization", "photodiode array"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 15)),
        "Topic :: Scientific/Engineering",
    ],
    author="uuv_optical_array developers",
    maintainer="uuv_optical_array developers",
    maintainer_email="maintainers@uuv-optical-array.org",
    license="Apache-2.0",
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (share, ["package.xml"]),
        (f"{share}/launch", glob("launch/*.launch.py")),
        (f"{share}/config", glob("config/*.*")),
        (f"{share}/config/scenes", glob("config/scenes/*.yaml")),
        (f"{share}/config/flux", glob("config/flux/*.npz")),
        (f"{share}/config/examples", glob("config/examples/*.yaml")),
        (f"{share}/config/security", glob("config/security/*.xml")),
        (f"{share}/rviz", glob("rviz/*.rviz")),
    ],
    python_requires=">=3.10",
    # The least versions are those of Ubuntu 22.04, the oldest under a supported ROS 2.
    install_requires=[
        "matplotlib>=3.5",
        "numpy>=1.21",
        "rich>=11",
        "ruamel.yaml>=0.17.16",
        "scipy>=1.8",
        "setuptools",
        "tqdm>=4.57",
    ],
    extras_require={
        # ROS 2 Kilted for a machine without ROS; a ROS workspace has these by package.xml.
        "ros": [
            "ros-diagnostic-msgs",
            "ros-geometry-msgs",
            "ros-nav-msgs",
            "ros-rclpy[fastrtps]",
            "ros-sensor-msgs",
            "ros-std-msgs",
            "ros-std-srvs",
            "ros-visualization-msgs",
            "transforms3d",
        ],
        # The compiled fit. Numba 0.58.0 asks for NumPy 1.21 and does not import with it.
        "fast": ["numba!=0.58.0"],
        # Large signature tables on disk, written by threads or a cluster.
        "cluster": CLUSTER,
        # Recorded bags.
        "bags": BAGS,
        # An array on a serial line or a socket, as examples/serial_array_node.py reads it.
        "hardware": HARDWARE,
        # The live view; its client is in its wheel.
        "view": VIEW,
        # What `make peers` measures us against; see benchmarks/peers.
        "peers": ["faiss-cpu", "numba", "scikit-learn", "spectral", "threadpoolctl"],
        # Building the documentation, by `make docs`.
        "docs": ["furo", "myst-parser", "numpydoc", "sphinx"],
        # colcon test runs pytest because this extra names it.
        "test": [
            "hypothesis",
            "jerlov",
            "jsonschema",
            "mypy",
            "numba",
            "PyYAML",
            "pytest<9",
            "pytest-benchmark",
            "pytest-timeout",
            "pytest-xdist",
            "ruff",
            *BAGS,
            *CLUSTER,
            *HARDWARE,
            *VIEW,
        ],
    },
    entry_points={
        "console_scripts": [
            *(f"{name}_node = {package_name}.programs:{name}_node" for name in NODES),
            f"uuv_array = {package_name}.programs:uuv_array",
        ],
    },
)
