"""The parts of the report: its input, the verdict, the numbers, the pictures, the plots."""

from scanner.reporting.contents import CaptureRow, JointCaptures, ReportInput
from scanner.reporting.page import write_report
from scanner.reporting.sections import PageImage, ScaledMap, picture
from scanner.reporting.svg import HEIGHT, WIDTH, Plot, Scale
from scanner.reporting.verdict import verdict
