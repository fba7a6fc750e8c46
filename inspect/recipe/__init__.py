"""The recipe: expected part, poses and acquisition, and the decision rule."""
