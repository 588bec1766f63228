# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

from glob import glob
import os
from pathlib import Path
from runpy import run_path
import shutil

from setuptools import Extension
from setuptools import find_packages
from setuptools import setup
from setuptools.command.build_ext import build_ext

package_name = 'closedloop_dynamics'
engine = run_path(os.path.join(package_name, 'engine', 'build.py'))
share = os.path.join('share', package_name)
# A placeholder, as the maintainer's address is: CONTRIBUTING.md says what a release needs.
home = f'https://example.org/{package_name}'


def shared(pattern):
    """List the files that match, by the directory they are installed to."""
    places = {}
    for path in sorted(glob(pattern, recursive=True)):
        if os.path.isfile(path):
            places.setdefault(os.path.join(share, os.path.dirname(path)), []).append(path)
    return list(places.items())


class BuildEngine(build_ext):
    """Compiles the engine with its own commands, not with those of Python."""

    @property
    def target(self):
        """Return the machine that the option --plat-name of a wheel names; None: this one."""
        wheel = self.distribution.get_command_obj('bdist_wheel', create=False)
        return engine['TARGETS'][wheel.plat_name] if wheel and wheel.plat_name_supplied else None

    def get_ext_filename(self, fullname):
        """Return the path of the file below that of the package."""
        return os.path.join(*fullname.split('.')[:-1], engine['module'](self.target))

    def build_extension(self, extension):
        """Compile into the file that setuptools expects."""
        output = Path(self.get_ext_fullpath(extension.name))
        present = Path(self.get_ext_filename(extension.name))
        if self.editable_mode and engine['fresh'](present):
            # In a checkout it may be there, and no compiler, which nothing else needs then.
            if not output.exists() or not output.samefile(present):
                output.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(present, output)
            return
        print('Compiling the engine: this takes about a minute', flush=True)
        # What serves a checkout is kept there, for the next change of a source.
        objects = engine['OBJECTS'] if self.editable_mode else Path(self.build_temp)
        try:
            engine['build'](output, objects, target=self.target)
        except engine['BuildError'] as error:
            raise SystemExit(f'Error: {error}') from None


extras = {
    # Recordings of ROS: bags.
    'bags': ['mcap>=1.6', 'rosbags>=0.11'],
    # What benchmark/peers.py compares with; Eigen's headers for its C++ loop.
    'bench': ['casadi==3.8.2', 'cmeel-eigen==3.4.1', 'drake==1.51.1', 'exudyn==1.13.6',
              'mujoco==4.0.0', 'pin==4.1.0'],
    # To complete words of the command line in a shell.
    'completion': ['argcomplete>=3.2'],
    # Linear models as those of python-control.
    'control': ['control>=0.10'],
    # To write DXF files.
    'drawing': ['ezdxf>=1.3'],
    # Environments for reinforcement learning.
    'gymnasium': ['gymnasium>=1.1'],
    # Forward dynamics as a function of JAX.
    'jax': ['jax>=0.4.34'],
    # To read MJCF and xacro files; to show the meshes of models.
    'models': ['mujoco>=3.3', 'trimesh>=4.0', 'xacro>=2.0'],
    # Pictures and animations.
    'plot': ['matplotlib>=3.6', 'pillow>=10.2'],
    # The solver of predictive control.
    'predictive': ['piqp>=0.6'],
    # Documents and load spectra of closedloop report.
    'report': ['fpdf2>=2.7', 'rainflow>=3.1'],
    # For Pythons without a ROS installation: Jazzy from PyPI.
    'ros': [
        'ros-jazzy-rclpy[fastrtps]',
        'ros-jazzy-common-interfaces',
    ],
    # What closedloop sweep writes to, and a cluster to run it on; each on its own is enough.
    'sweep': ['distributed>=2024.1', 'netCDF4>=1.6.5', 'zarr>=3.0.8'],
    # colcon test looks for pytest here; without it, it finds no tests and passes.
    'test': ['hypothesis', 'mcap-ros2-support', 'mypy==2.4.1', 'pytest', 'pytest-timeout',
             'ruff==0.17.6'],
    # Steps as an operator of PyTorch.
    'torch': ['torch>=2.5'],
    # The page of closedloop view.
    'view': ['websockets>=14.0'],
}
extras['report'] += extras['plot']
extras['ros'] += extras['bags'] + extras['view']
# What people use side by side; the others are for a library or a program of their own each.
extras['all'] = [one for name in ('plot', 'bags', 'view', 'models', 'report', 'drawing', 'sweep')
                 for one in extras[name]]


setup(
    name=package_name,
    version='1.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['__init__.pyi', 'py.typed'], package_name + '.view': ['page/*']},
    ext_modules=[Extension(
        f'{package_name}.engine.native', sorted(glob(f'{package_name}/engine/*.cpp')),
        py_limited_api=True)],
    cmdclass={'build_ext': BuildEngine},
    # One file serves every Python from 3.11 on.
    options={'bdist_wheel': {'py_limited_api': 'cp311'}},
    setup_requires=engine['requirements'](),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        (share, ['package.xml']),
        *shared('config/**/*.json'),
        *shared('config/**/*.rviz'),
        *shared('config/**/*.srdf'),
        *shared('config/**/*.yaml'),
        *shared('launch/*'),
    ],
    python_requires='>=3.11',
    # More than these is an extra: closedloop_dynamics/mechanism/extras.py says what asks for it.
    install_requires=[
        'llvmlite>=0.43',
        'numpy>=1.26',
        'PyYAML>=6.0',
        'scipy>=1.11',
        'tqdm>=4.60',
    ],
    extras_require=extras,
    zip_safe=False,
    long_description=(Path(__file__).resolve().parent / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    classifiers=[
        'Development Status :: 5 - Production/Stable',
        'Intended Audience :: Education',
        'Intended Audience :: Science/Research',
        'Operating System :: MacOS',
        'Operating System :: Microsoft :: Windows',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: C++',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Programming Language :: Python :: 3.14',
        'Topic :: Scientific/Engineering :: Physics',
        'Typing :: Typed',
    ],
    keywords=['ROS', 'multibody dynamics', 'closed loops', 'linkage', 'parallel robot'],
    url=home,
    project_urls={
        'Changelog': f'{home}/blob/main/CHANGELOG.rst',
        'Documentation': f'{home}/doc',
        'Issues': f'{home}/issues',
        'Source': home,
    },
    author='The closedloop_dynamics authors',
    maintainer='The closedloop_dynamics authors',
    maintainer_email='closedloop_dynamics@example.org',
    description='Simulates mechanisms with closed loops, in the plane and in space, live over '
                'ROS 2 or offline.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'closedloop = closedloop_dynamics.cli:program',
            'closedloop_estimator = closedloop_dynamics.ros.process:estimator',
            'closedloop_joint_states = closedloop_dynamics.ros.process:joint_states',
            'closedloop_recorder = closedloop_dynamics.ros.process:recorder',
            'closedloop_simulator = closedloop_dynamics.ros.process:simulator',
            'closedloop_torque_source = closedloop_dynamics.ros.process:torque_source',
            'closedloop_viewer = closedloop_dynamics.ros.process:viewer',
        ],
    },
)
