"""Things: how several stations of one rig see one free-form thing that was moved in between, by its surface alone."""

from calib.objects.axis import Turntable, find_turntable
from calib.objects.background import FEWEST as FEWEST_TO_REST
from calib.objects.background import in_planes, resting_depth, resting_planes, within
from calib.objects.joint import JointEstimate, estimate_jointly
from calib.objects.patch_overlap import confirmed
from calib.objects.registration import TOO_SMALL, AlternativePose, Registered, register_views
from calib.objects.view import FEWEST_PIXELS, ObjectView, view_of
