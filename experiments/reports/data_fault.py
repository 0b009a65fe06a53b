"""The report of `starleth diagnose` on a log whose data cannot be believed."""

from pathlib import Path

from experiments.measurement.intake import LogFault
from experiments.reports.page import Card, Cards, Section, Table, Text, write_report


def write_fault_report(path: Path, fault: LogFault) -> None:
    """One HTML file that needs no network: what is wrong with the log, and where. Raises UserError."""
    rows = [(one.fault.replace("_", " "), one.where, one.message) for one in fault.faults]
    sections = [
        Section("Result", [Cards([Card("Verdict", "data fault", tone="bad")]), Text(str(fault), "lead")]),
        Section("What is wrong with the log", [Table(("fault", "where", "what to do"), rows, "Faults of the data.")]),
    ]
    write_report(path, "Diagnosis", str(fault.log), sections)
