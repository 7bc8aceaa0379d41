"""Run the pages' questions: without arguments compare with the answers shown there, with --write put them in."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ("README.md", "docs/results.md")


def answer(command: str) -> str:
    """What the command prints."""
    program, *words = shlex.split(command)
    path = Path(sys.executable).with_name(program)
    done = subprocess.run([path, *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout


def main() -> None:
    """Replace or compare every ```console block of every page."""
    for name in PAGES:
        page = ROOT / name
        text = page.read_text(encoding="utf-8")
        fresh = re.sub(
            r"```console\n\$ (.+)\n[^`]*```", lambda block: f"```console\n$ {block[1]}\n{answer(block[1])}```", text
        )
        if "--write" in sys.argv:
            page.write_text(fresh, encoding="utf-8")
        elif fresh != text:
            sys.exit(f"{name} shows other answers than these commands give; run `python .ci/readme.py --write`")
        print(f"{name}: {len(re.findall('```console', text))} questions answered as shown")


main()
