"""From frames to pose radiances and deviation maps."""
