"""Run what the pages show: without arguments compare with the answers shown there, with --write put them in.

The tutorial adds a task to the project, so it runs in a copy.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/results.md", "docs/sql.md")
TUTORIAL = "docs/tutorial.md"
CONSOLE = re.compile(r"```console\n\$ (.+)\n[^`]*```")
BLOCK = re.compile(r"```(?:console\n\$ .+\n[^`]*|sh\n[^`]*)```")


def answer(command: str, folder: Path = ROOT) -> str:
    """What the command prints."""
    program, *words = shlex.split(command)
    path = Path(sys.executable).with_name(program)
    env = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [path if path.exists() else program, *words], cwd=folder, env=env, capture_output=True, text=True, check=True
    )
    return done.stdout


def answered(text: str, folder: Path = ROOT) -> str:
    """A page with every answer as it is now."""
    return CONSOLE.sub(lambda block: f"```console\n$ {block[1]}\n{answer(block[1], folder)}```", text)


def followed(text: str, most: Callable[[str], bool] = lambda block: True) -> str:
    """The tutorial as it is now: its blocks are followed from the first on, in a copy of the project."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "project"
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, listed.split("\0")):
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, copy / name)
        done, going = [], True
        for part in re.split(f"({BLOCK.pattern})", text):
            going = going and (not BLOCK.fullmatch(part) or most(part))
            if going and part.startswith("```console"):
                part = answered(part, copy)
            elif going and part.startswith("```sh"):
                for line in part.splitlines()[1:-1]:
                    answer(line, copy)
            done.append(part)
    return "".join(done)


def main() -> None:
    """Replace or compare every block of every page."""
    for name in (*PAGES, TUTORIAL):
        page = ROOT / name
        text = page.read_text(encoding="utf-8")
        fresh = followed(text) if name == TUTORIAL else answered(text)
        if "--write" in sys.argv:
            page.write_text(fresh, encoding="utf-8")
        elif fresh != text:
            sys.exit(f"{name} shows other answers than these commands give; run `python .ci/readme.py --write`")
        print(f"{name}: {len(re.findall('```console', text))} questions answered as shown")


if __name__ == "__main__":
    main()
