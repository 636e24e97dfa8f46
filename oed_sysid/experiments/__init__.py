"""What is done with a vehicle: manoeuvres, experiments and their limits, simulation, problems."""
