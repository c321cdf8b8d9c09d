"""A force sensor with a Kalman filter, as a component for robomill."""
