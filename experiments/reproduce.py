"""Everything of the paper, from data to report; the same command goes on where it was.

ssmr reproduce preset=quick executor=joblib workers=2
"""

from ssmr_torch.experiments.entry import entry_point


@entry_point("reproduce")
def main(config, directory):
    from ssmr_torch.configuration import built, own_folders, plain
    from ssmr_torch.paper.reproduction import reproduce

    given = plain(config, without=["executor"])
    report, failures = reproduce(given["preset"], given["figures"] or [], directory, built(config.executor),
                                 recordings=given["recordings"], groups=own_folders())
    print(f"report: {report}")
    if failures:
        raise SystemExit("\n".join(["reproduce: something failed, and the same command tries it again", *failures]))
    return 0.0


if __name__ == "__main__":
    main()
