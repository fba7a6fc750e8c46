"""The line: jobs that a controller orders at a rig, by OPC UA, MQTT or Modbus/TCP."""
