"""`check`: runs all recording checks on a dataset before a fit, and reports their findings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.coverage import coverage
from ssmr_torch.recording_checks.decays import decays
from ssmr_torch.recording_checks.faults import faults
from ssmr_torch.recording_checks.finding import SEVERITIES, Finding
from ssmr_torch.recording_checks.held_out import held_out
from ssmr_torch.recording_checks.signals import delay, dither, noise, sampling
from ssmr_torch.recording_checks.statics import drift, friction, neutral
from ssmr_torch.trajectory import TrajectoryDataset, refuse_other_data

CHECKS = (faults, decays, coverage, dither, held_out, noise, sampling, delay, friction, drift, neutral)


@dataclass(frozen=True, eq=False)
class RecordingsReport(DataSheet):
    """The findings of all recording checks, one per subject, each with a severity, a number and a remedy."""

    findings: tuple[Finding, ...]
    title: str
    dataset: TrajectoryDataset

    def __getitem__(self, subject: str) -> Finding:
        """The finding of a subject. Raises KeyError for an unknown subject and lists all subjects."""
        for finding in self.findings:
            if finding.subject == subject:
                return finding
        raise KeyError(f"there is no finding {subject!r}; the findings are {[each.subject for each in self.findings]}")

    def counts(self) -> dict[str, int]:
        """Number of findings of each severity."""
        return {severity: sum(each.severity == severity for each in self.findings) for severity in SEVERITIES}

    def as_dict(self) -> dict:
        """Plain values for each subject: severity, sentence, remedy, and numbers in SI units."""
        return {each.subject: {"severity": each.severity, "said": each.said, "remedy": each.remedy,
                               "numbers": each.numbers} for each in self.findings}

    def data_sheet(self) -> tuple[str, dict]:
        counted = sheet.listed(f"{count} {severity}" for severity, count in self.counts().items())
        return f"Recordings: {self.title}; {counted}", {each.subject: str(each) for each in self.findings}

    def figures(self, directory: str | Path) -> list[Path]:
        """Draw the findings into directory/recordings.svg; needs matplotlib (extra train)."""
        from ssmr_torch.evaluation import recordings_figures

        return recordings_figures.save_all(self.findings, directory, self.dataset.output_names)


def check(data: TrajectoryDataset) -> RecordingsReport:
    """Check recordings before a fit: faults, decays, range, dither, held-out runs, noise, sampling, delay, friction,
    drift and the neutral input. Each finding has a number and, if something is wrong, a remedy.

    data: from `read`, `load` or `trajectories`. The training runs are checked, and nothing is changed. If the runs do
    not show a subject, its severity is "unknown".
    Raises TypeError for an object that is not a dataset.
    """
    refuse_other_data(data)
    recorded = Recorded(data)
    title = (f"{len(data)} runs, {sum(run.length for run in data)} samples, {sheet.period(data.timestep)}")
    return RecordingsReport(tuple(found(recorded) for found in CHECKS), title, data)
