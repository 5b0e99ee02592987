"""Everything of the paper, from data to report; the same command goes on where it was.

ssmr reproduce preset=quick executor=joblib workers=2
"""

from ssmr_torch.entry_point import entry_point


@entry_point("reproduce", resumed="")
def main(config, directory):
    from ssmr_torch.configuration import built, own_folders, plain
    from ssmr_torch.paper.jobs import plan
    from ssmr_torch.paper.reproduction import report, reproduce

    asked = plan(plain(config.preset), config.figures, config.recordings)
    failures = reproduce(asked, directory, built(config.executor), own_folders())
    print(f"report: {report(directory, asked.figures)}")
    if failures:
        raise SystemExit("\n".join(["reproduce: something failed, and the same command tries it again", *failures]))
    return 0.0


if __name__ == "__main__":
    main()
