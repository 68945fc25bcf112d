"""The study's report (`document.write_report`): texts in report.md.j2, and tables whose cells the other modules compute."""
