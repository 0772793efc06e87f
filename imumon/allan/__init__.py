"""Allan, modified Allan and Hadamard deviations of an IMU, and the noise terms behind them."""
