"""Physics: models, and the engine that moves them. Nothing else imports MuJoCo."""

# First, as it imports MuJoCo even where MUJOCO_GL names a library that is missing.
from maesn.physics.graphics import RenderingError as RenderingError
from maesn.physics.graphics import offscreen_library as offscreen_library

# isort: split
from maesn.physics.base import PhysicsError as PhysicsError
from maesn.physics.base import Readings as Readings
from maesn.physics.interface import field_values as field_values
from maesn.physics.interface import model_actuators as model_actuators
from maesn.physics.interface import reading_owners as reading_owners
from maesn.physics.interface import resting_readings as resting_readings
from maesn.physics.loading import load_model as load_model
from maesn.physics.native import NativeSimulator as NativeSimulator
from maesn.physics.rendering import Marks as Marks
from maesn.physics.rendering import Renderer as Renderer
from maesn.physics.rendering import View as View
