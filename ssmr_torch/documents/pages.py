"""Blocks of numbers in README.md and docs/*.md: found, written from their stores, and compared with them.

A block begins with the comment `<!-- numbers: NAME -->` and ends with `<!-- end -->`. What lies between is written from
docs/numbers/NAME.json and never by hand.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from ssmr_torch.documents.store import FOLDER, Numbers, read_all
from ssmr_torch.documents.stray_numbers import allowed, stray_numbers
from ssmr_torch.result_files import save_text

BLOCK = re.compile(r"<!-- numbers: (?P<name>[^\s>]*) -->\n(?P<body>.*?)(?P<end><!-- end -->|(?=<!-- numbers: )|\Z)",
                   re.DOTALL)


def pages(root: Path) -> list[Path]:
    """README.md and every page of docs/."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def rendered(text: str, stores: Mapping[str, Numbers]) -> str:
    """The text of a page with every block written from its store. Raises ValueError as `faults_of_blocks` says."""
    faults = faults_of_blocks(text, stores)
    if faults:
        raise ValueError("; ".join(faults))
    return BLOCK.sub(lambda block: f"<!-- numbers: {block['name']} -->\n{stores[block['name']].markdown()}\n"
                                   "<!-- end -->", text)


def faults_of_blocks(text: str, stores: Mapping[str, Numbers]) -> list[str]:
    """What is wrong with the blocks of a page: no end, or a name without a store."""
    found = []
    for block in BLOCK.finditer(text):
        if not block["end"]:
            found.append(f"the block {block['name']} has no <!-- end -->")
        if block["name"] not in stores:
            found.append(f"the block {block['name']} has no {FOLDER / block['name']}.json; "
                         f"`ssmr docs-numbers from=DIR name={block['name']}` writes it from results")
    return found


def render_pages(root: Path) -> list[Path]:
    """Write the blocks of all pages from their stores, aside, then renamed; the pages that have changed.

    Raises ValueError, and changes no page, where a block has no end or no store.
    """
    stores, texts = read_all(root), {}
    for path in pages(root):
        old = path.read_text(encoding="utf-8")
        try:
            new = rendered(old, stores)
        except ValueError as error:
            raise ValueError(f"{path.relative_to(root)}: {error}") from error
        if new != old:
            texts[path] = new
    for path, text in texts.items():
        save_text(path, text)
    return list(texts)


def faults(root: Path) -> list[str]:
    """What is wrong with the numbers of the documentation, one sentence each; none where all is well.

    A block must equal its store, a store must be shown by a page, and a measured number stands in a block
    (`stray_numbers`).
    """
    stores, kinds, found, shown = read_all(root), allowed(root), [], set()
    everywhere = [str(number) for each in kinds.pop("everywhere", {}).values() for number in each]
    for path in pages(root):
        page, text = path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")
        shown |= {block["name"] for block in BLOCK.finditer(text)}
        wrong = faults_of_blocks(text, stores)
        if not wrong and rendered(text, stores) != text:
            wrong = ["a block differs from its store; `ssmr docs-numbers` writes it"]
        wrong += stray_numbers(text, kinds.pop(page, {}), everywhere)
        found += [f"{page}: {each}" for each in wrong]
    found += [f"{FOLDER / name}.json is shown on no page" for name in stores if name not in shown]
    found += [f"{FOLDER}/allowed.yaml names {page}, which does not exist" for page in kinds]
    return found
