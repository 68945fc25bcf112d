"""The study's report: one HTML page without external resources (`html_page.write_report`), and each of its tables as CSV."""
