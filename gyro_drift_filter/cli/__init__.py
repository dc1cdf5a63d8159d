"""The command `gyro_drift`: parsing of arguments and printing only."""

import os

# numpy starts a thread for each processor, which wait busily for products of matrices, and takes
# 70 of its 150 ms for that. None is large enough here to gain by them.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
