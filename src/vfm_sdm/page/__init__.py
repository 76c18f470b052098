"""The browser page: from films to a report by clicking, on this machine alone (extra ``page``)."""
