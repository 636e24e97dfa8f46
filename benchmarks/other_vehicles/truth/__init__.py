"""The vehicles as they are: simulators that share no code with the package."""

from benchmarks.other_vehicles.truth.auv import AUV
from benchmarks.other_vehicles.truth.catamaran import CATAMARAN
from benchmarks.other_vehicles.truth.coaster import COASTER
from benchmarks.other_vehicles.truth.motor import MOTOR
from benchmarks.other_vehicles.truth.simulator import Vehicle

VEHICLES: dict[str, Vehicle] = {
    vehicle.name: vehicle for vehicle in (COASTER, CATAMARAN, AUV, MOTOR)
}
