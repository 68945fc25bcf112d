# The whole system on any Linux or Mac: docs/how-to/run-in-a-container.md says how to run it.
FROM debian:trixie-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates && rm -rf /var/lib/apt/lists/*
WORKDIR /opt/virtual_borders
COPY requirements.in requirements.txt ./
COPY scripts/setup scripts/
COPY scripts/packages/debian.txt scripts/packages/
RUN scripts/setup --packages --parts "build run" && rm -rf /var/lib/apt/lists/* logs
COPY . .
RUN scripts/setup --parts "build run" && .venv/bin/python -m compileall -q src devel/lib && rm -rf build logs .git \
    && find .venv -name __pycache__ -prune -o -name '*.pyi' -exec rm {} +

FROM debian:trixie-slim
# "run rviz" for RViz on this computer's screen
ARG PARTS=run
WORKDIR /opt/virtual_borders
COPY scripts/setup scripts/
COPY scripts/packages/debian.txt scripts/packages/
RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates && scripts/setup --packages --parts "$PARTS" \
    && apt-get clean && rm -rf /var/lib/apt/lists/* logs /usr/share/doc /usr/share/man /usr/share/locale \
    # Debian's message packages bring a compiler's headers and libraries along, which nothing here uses: 0.4 GB
    && rm -rf /usr/include /usr/lib/gcc /usr/share/cmake-* /usr/bin/cmake /usr/bin/ctest /usr/bin/cpack \
    && find /usr/lib -name '*.a' -delete \
    && useradd --create-home --groups audio,video lab && install -d -o lab /state
COPY --from=build /opt/virtual_borders /opt/virtual_borders
RUN install -d -o lab logs out
USER lab
VOLUME /state
EXPOSE 8420
# the page answers; starting takes up to a minute
HEALTHCHECK --start-period=60s --interval=10s CMD python3 -c "import urllib.request; urllib.request.urlopen('http://localhost:8420/', timeout=5)"
ENTRYPOINT ["/opt/virtual_borders/scripts/container"]
CMD ["simulation"]
