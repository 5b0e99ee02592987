"""Everything below one directory → report.html there.

ssmr report directory=outputs/run
"""

from ssmr_torch.entry_point import entry_point


@entry_point("report")
def main(config, directory):
    from ssmr_torch.provenance import provenance
    from ssmr_torch.report.html_page import write_report
    from ssmr_torch.report.run_sections import collect_sections

    sections = collect_sections(config.directory)
    origin = {name: str(value) for name, value in provenance().items()}
    print(f"report: {write_report(config.directory, config.title, sections, origin)}")


if __name__ == "__main__":
    main()
