"""A result: its folder, its verdict, its metadata."""

from scanner.results.calibration_log import (
    LOGGED,
    LogEntry,
    LoggedParameter,
    differences,
    entry_for,
    log_of,
    log_text,
    read_log,
)
from scanner.results.cloud_steps import read_steps, write_steps
from scanner.results.finished_result import (
    FinishedResult,
    KeptPoints,
    PlacedScan,
    capture_folders,
    is_merged,
    read_finished_result,
    read_joined,
)
from scanner.results.finished_scan import FinishedScan, read_calibration_of, read_finished_scan
from scanner.results.job import Job
from scanner.results.leftovers import frames_in, kept_text, settle
from scanner.results.names import (
    CALIBRATION_FILE,
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    CLOUD_FILE,
    CORNER,
    DENSE_FILE,
    KINDS,
    LOG_FILE,
    MERGED_FILE,
    NETWORK,
    NETWORK_CLOUD_FILE,
    NETWORK_FILE,
    OBJECT,
    OBJECT_CLOUD_FILE,
    OBJECT_FILE,
    OBJECT_MESH_FILE,
    PLAN_DXF_FILE,
    PLAN_FILE,
    POSES_FILE,
    REFUSAL_FILE,
    REPORT_FILE,
    ROOM,
    ROOM_CLOUD_FILE,
    ROOM_FILE,
    ROOM_MESH_FILE,
    STEPS_FILE,
    TRUTH_FILE,
    ResultKind,
    calibration_file,
    default_out,
    folder_of,
    kind_of,
    path_beside,
    refuse_occupied,
    unused,
)
from scanner.results.provenance import Provenance, provenance
from scanner.results.result_folder import OutputFolder, new_result
from scanner.results.stages import (
    AS_SHOWN,
    Calibrated,
    Decoded,
    GivenCalibration,
    GivenMatches,
    Panel,
    Reconstructed,
    Refused,
    Scan,
    SelfCalibrated,
    Stage,
    decoded_of,
    findings_on,
    naming,
    solution_of,
    titles_of,
)
from scanner.results.stated_network import NetworkErrors, network_error_entries, read_network_errors
from scanner.results.stated_pose_errors import pose_error_entries, read_pose_errors
from scanner.results.stated_uncertainty import (
    COLUMNS,
    confidence_entries,
    covariance_entries,
    read_uncertainty,
)
from scanner.results.unfinished import Claim, FolderState
from scanner.results.verdict import (
    DECISIVE,
    MEASUREMENT_GRADE,
    SIGNS,
    Grade,
    Verdict,
    finding_entries,
    fit_together,
    read_verdict,
    verdict_entries,
    verdict_of,
    write_refusal,
)
