"""Recordings → what they lack before any fit: decays, range, dither, held-out runs, noise, delay, friction, drift.

ssmr check recordings=CARD.yaml
"""

from hydra.utils import instantiate

from ssmr_torch.entry_point import entry_point, origin_of, save_json, save_result
from ssmr_torch.result_files import save_text


@entry_point("check")
def main(config, directory):
    from ssmr_torch import face

    given = face.read(config.recordings) if config.recordings else instantiate(config.data)
    report = face.check(given.observing(config.outputs))
    save_text(directory / "check.txt", f"{report}\n")
    origin = origin_of(config, resolve=False)
    save_json(directory / "check.json", {"findings": report.as_dict(), "data": given.provenance, "provenance": origin})
    drawn = report.figures(directory) if config.figures else []
    print("\n".join([str(report), *map(str, drawn), str(directory / "check.json")]))
    counts = report.counts()
    save_result(directory, {severity: float(count) for severity, count in counts.items()})
    return float(counts["missing"])


if __name__ == "__main__":
    main()
