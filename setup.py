"""What pyproject.toml cannot say: a wheel has one name, `lessbench`, with the code and what projects begin with in it.

In the repository the code stays where it is, in `pipeline` and `schemas`, and is installed so by `make install`.
"""

import shutil
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
INNER = "lessbench._code"
DATA = {
    "pipeline": ["py.typed", "survey/*.yaml", "survey/texts/*.yaml", "survey/pages/*"],
    "schemas": ["*.toml", "*.ros2msg", "py.typed"],
}
BEGINNING = ("params.yaml", "datasets/robots", "datasets/scenes", "datasets/studies/human_choice", "examples/carry_mug")
"""As `pipeline/commands/init.py` has it."""


class BuildWithBeginning(build_py):
    """Copies what a project begins with."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        for name in BEGINNING:
            target = Path(self.build_lib, *INNER.split("."), name)
            target.parent.mkdir(parents=True, exist_ok=True)
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, target, dirs_exist_ok=True)
            else:
                shutil.copy(ROOT / name, target)


editable = "editable_wheel" in sys.argv
code = find_packages(include=[f"{name}{end}" for name in DATA for end in ("", ".*")])
setup(
    packages=["lessbench", *(code if editable else (f"{INNER}.{name}" for name in code))],
    package_dir={} if editable else {f"{INNER}.{name}": name for name in DATA},
    package_data={"lessbench": ["py.typed"]}
    | {name if editable else f"{INNER}.{name}": files for name, files in DATA.items()},
    cmdclass={"build_py": BuildWithBeginning},
)
