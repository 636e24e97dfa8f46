"""What disturbs a vehicle and its sensors: linear deviations, Kalman filter, smoother, levels."""
