"""Text files end with one newline and have no blanks at the ends of lines, and YAML can be read: a pre-commit hook.

python tools/check_text_files.py FILE …
"""

import sys
from pathlib import Path

import yaml


def faults(path: Path) -> list[str]:
    """What is wrong with a file, a sentence each."""
    text = path.read_text(encoding="utf-8")
    found = [f"{path}: line {number} ends with blanks" for number, line in enumerate(text.split("\n"), start=1)
             if line != line.rstrip()]
    if text and (not text.endswith("\n") or text.endswith("\n\n")):
        found.append(f"{path}: expected one newline at the end")
    if path.suffix in (".yaml", ".yml") and path.name != "mkdocs.yml":  # that one names Python objects
        try:
            yaml.safe_load(text)
        except yaml.YAMLError as error:
            found.append(f"{path}: {error}")
    return found


if __name__ == "__main__":
    wrong = [fault for name in sys.argv[1:] for fault in faults(Path(name))]
    sys.exit("\n".join(wrong) if wrong else 0)
