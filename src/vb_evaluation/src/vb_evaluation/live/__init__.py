"""What runs beside a live system: the demonstration, its pictures, and the check of a robot's navigation."""
