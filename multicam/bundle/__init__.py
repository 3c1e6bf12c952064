"""Joint refinement of cameras and objects: factors with analytic Jacobians, and the solver that knows no cameras."""
