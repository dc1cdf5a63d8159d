"""What an accelerometer measures at rest."""

GRAVITY = 9.80665  # m/s^2, the standard one; on the ground it differs by 0.3 % at most
