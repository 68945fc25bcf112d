"""The smart home's hub: Home Assistant and others, by MQTT."""
