"""Rewrite the code that every stage of dvc.yaml depends on, from what its module imports: `python .ci/stage_deps.py`."""

import re
import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Replace each stage's `- pipeline/...` lines by the files of its module's closure."""
    graph = runpy.run_path(str(ROOT / "tests" / "stages" / "test_graph.py"))
    page = ROOT / "dvc.yaml"
    blocks = re.split(r"(?m)^(?=  [\w-]+:$)", page.read_text(encoding="utf-8"))
    for place, block in enumerate(blocks):
        command = re.search(r"cmd: (lessbench .+)", block)
        if command is None:
            continue
        code = graph["closure"](graph["module_of"](command[1]))
        indent = re.search(r"(?m)^( +)deps:$", block)[1] + "  "
        lines = "".join(f"{indent}- {path}\n" for path in sorted(code) if not path.endswith("/__init__.py"))
        listed = rf"(?m)^{indent}- pipeline/.+\n"
        at = re.search(listed, block).start()
        blocks[place] = block[:at] + lines + re.sub(listed, "", block[at:])
    page.write_text("".join(blocks), encoding="utf-8")


main()
