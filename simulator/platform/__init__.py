"""Platform: place and attitude of the camera, and the readings of its clock, GPS and star tracker."""
