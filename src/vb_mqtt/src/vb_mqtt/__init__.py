"""Connects the smart home's hub, such as Home Assistant, by MQTT."""
