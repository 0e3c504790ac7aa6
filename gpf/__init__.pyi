"""The public names: ``gpf`` loads them from these modules on first use."""

from .core.errors import FileError as FileError
from .core.errors import UserError as UserError
from .core.runtime import choose_variant as choose_variant
from .core.structs import Photons as Photons
from .field.field import GaussianPhotonField as GaussianPhotonField
from .field.io import load_field as load_field
from .field.io import save_field as save_field
from .field.settings import FieldSettings as FieldSettings
from .fitting.fit import fit as fit
from .fitting.frames import Frame as Frame
from .fitting.frames import fit_frames as fit_frames
from .guiding.emission_plan import EmissionPlan as EmissionPlan
from .guiding.emission_plan import VisibleRegionSettings as VisibleRegionSettings
from .photons.tracing import PathSettings as PathSettings
from .rendering.settings import RenderSettings as RenderSettings
from .scene.load import load_scene_file as load_scene_file
from .scene.sensors import make_sensor as make_sensor
from .scene.views import SceneViews as SceneViews
from .scene.views import View as View
from .scene.views import read_views as read_views
from .sppm.passes import PassSettings as PassSettings
from .sppm.reference import ReferenceSettings as ReferenceSettings
from .training.settings import TrainingSettings as TrainingSettings
from .training.streaming import StreamSettings as StreamSettings

__version__: str
