"""The vehicles as they are: simulators that share no code with the package."""

from benchmarks.other_vehicles.truth.coaster import COASTER
from benchmarks.other_vehicles.truth.motor import MOTOR
from benchmarks.other_vehicles.truth.simulator import Vehicle

VEHICLES: dict[str, Vehicle] = {
    vehicle.name: vehicle for vehicle in (COASTER, MOTOR)
}
