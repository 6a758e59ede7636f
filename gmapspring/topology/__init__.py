"""The 3-dimensional generalized map: darts, cells, sewing; arrays and kernels that know no physics."""
