"""The parts of the report: what goes in, the verdict, the numbers, the pictures, the plots."""

from scanner.reporting.contents import CaptureRow, ReportInput
from scanner.reporting.page import write_report
from scanner.reporting.verdict import verdict
