"""What every estimator is made of: slots of samples, the Kalman filter's two steps, and the noise model."""
