"""URL handlers for pyserial: `protocol_sim` serves ``sim://…`` in this process."""
