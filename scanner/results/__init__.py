"""A result: its folder, its verdict, what it states about itself."""

from scanner.results.finished_scan import FinishedScan, read_calibration_of, read_finished_scan
from scanner.results.records import Findings, Scan
from scanner.results.result_folder import (
    CALIBRATION_FILE,
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    CLOUD_FILE,
    DENSE_FILE,
    LOG_FILE,
    MERGED_FILE,
    REPORT_FILE,
    TRUTH_FILE,
    OutputFolder,
    default_out,
    folder_of,
    new_result,
    refuse_occupied,
)
from scanner.results.stated_uncertainty import confidence_entries, read_uncertainty, read_verdict
from scanner.results.verdict import Verdict
