"""Measured numbers → the tables of README.md and docs/, each beside the command that measured them.

ssmr docs-numbers writes all tables; ssmr docs-numbers check=true compares them with docs/numbers
"""

from pathlib import Path

from ssmr_torch.entry_point import entry_point


@entry_point("docs_numbers")
def main(config, directory):
    from ssmr_torch.documents.pages import faults, render_pages
    from ssmr_torch.documents.results import store_results

    root = Path(config.root)
    if config["from"] is not None:
        print(store_results(root, Path(config["from"]), config.name, config.table, list(config.command or [])))
    if config.check:
        found = faults(root)
        if found:
            raise ValueError(f"{len(found)} faults in the numbers of the documentation:\n" + "\n".join(found))
        print("every table equals its store, and no measured number stands outside of a table")
    else:
        print("\n".join(map(str, render_pages(root))) or "no page has changed")


if __name__ == "__main__":
    main()
