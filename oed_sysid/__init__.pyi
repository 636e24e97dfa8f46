# Public names and the modules that hold them: type checkers read this, and so does the package.
# ruff: noqa: I001 (one import for each module)

from oed_sysid.data.dataset import (
    Dataset as Dataset,
    Record as Record,
    read_csv as read_csv,
    write_csv as write_csv,
)
from oed_sysid.data.logs import (
    import_log as import_log,
    open_log as open_log,
    read_mapping as read_mapping,
)
from oed_sysid.design import (
    AOptimal as AOptimal,
    Discriminate as Discriminate,
    DOptimal as DOptimal,
    DsOptimal as DsOptimal,
    EOptimal as EOptimal,
    GOptimal as GOptimal,
    Robust as Robust,
    VOptimal as VOptimal,
    design_experiment as design_experiment,
)
from oed_sysid.errors import OedSysidError as OedSysidError
from oed_sysid.evidence.check import check as check
from oed_sysid.evidence.compare import (
    compare as compare,
    diagnose as diagnose,
)
from oed_sysid.evidence.improve import improve as improve
from oed_sysid.evidence.usual import usual_effects as usual_effects
from oed_sysid.experiments.experiment import (
    Experiment as Experiment,
    Limits as Limits,
)
from oed_sysid.experiments.manoeuvres import (
    PRBS as PRBS,
    Chirp as Chirp,
    Combined as Combined,
    Constant as Constant,
    Doublet as Doublet,
    FromRecord as FromRecord,
    Multisine as Multisine,
    Piecewise as Piecewise,
    PullOut as PullOut,
    ReverseSpiral as ReverseSpiral,
    Spiral as Spiral,
    ThreeTwoOneOne as ThreeTwoOneOne,
    TurningCircle as TurningCircle,
    ZigZag as ZigZag,
    ZigZagLike as ZigZagLike,
)
from oed_sysid.experiments.problem import (
    Problem as Problem,
    list_problems as list_problems,
    load_problem as load_problem,
    new_problem as new_problem,
)
from oed_sysid.experiments.simulation import (
    simulate as simulate,
    simulate_inputs as simulate_inputs,
)
from oed_sysid.information import (
    information_of as information_of,
    rank_parameters as rank_parameters,
    reduce_model as reduce_model,
    structural_identifiability as structural_identifiability,
)
from oed_sysid.likelihood.estimator import Solver as Solver
from oed_sysid.likelihood.fit import Fit as Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting as MultipleShooting
from oed_sysid.likelihood.noise_model import (
    NoiseModel as NoiseModel,
    Sea as Sea,
)
from oed_sysid.likelihood.replay import replayed as replayed
from oed_sysid.physics import (
    Actuator as Actuator,
    Environment as Environment,
    ExtraState as ExtraState,
    Force as Force,
    Inertia as Inertia,
    InputNoise as InputNoise,
    Memory as Memory,
    RandomForce as RandomForce,
    Sensor as Sensor,
    SensorDrift as SensorDrift,
    UnknownForce as UnknownForce,
    UnknownInput as UnknownInput,
)
from oed_sysid.physics.channels import (
    Channels as Channels,
    Input as Input,
    Output as Output,
    State as State,
)
from oed_sysid.physics.model import Model as Model
from oed_sysid.physics.parameters import Parameter as Parameter
from oed_sysid.prediction.jackknife import jackknife as jackknife
from oed_sysid.prediction.speed_polar import speed_polar as speed_polar
from oed_sysid.prediction.turning_circle import turning_circle as turning_circle
from oed_sysid.runtime.version import __version__ as __version__
from oed_sysid.text.callables import Function as Function
