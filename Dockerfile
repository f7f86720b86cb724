# One image for all of covinz's server processes; docker-compose.yml says which container runs which.
# Plain enough for builders other than BuildKit. docs/deployment.md tells how to use it.

FROM python:3.11-slim-bookworm AS build
# Compilers that run at once; each takes up to 1 GB.
ARG JOBS=2

RUN apt-get update -qq \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
      cmake g++ libeigen3-dev libopencv-core-dev libopencv-features2d-dev libopengv-dev \
      ninja-build \
 && rm -rf /var/lib/apt/lists/*

# OpenCV's dependencies ask for an OpenGL driver, which nothing here uses: an empty package in its
# place saves 230 MB.
RUN mkdir -p /no-gl/DEBIAN \
 && printf '%s\n' 'Package: covinz-no-gl' 'Version: 1' 'Architecture: all' 'Provides: libglx-mesa0' \
      'Maintainer: covinz' 'Description: stands for the OpenGL driver' > /no-gl/DEBIAN/control \
 && dpkg-deb --build /no-gl /no-gl.deb

# What the server imports goes into /opt/covinz, what only builds it does not.
WORKDIR /src
COPY pyproject.toml requirements.txt ./
RUN python -m venv --without-pip /opt/covinz \
 && python -c 'import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
print(*project["dependencies"], sep="\n")' > runtime.txt \
 && python -m pip --python /opt/covinz/bin/python install --quiet --no-cache-dir -r runtime.txt \
 && python -m venv /opt/build \
 && /opt/build/bin/pip install --quiet --no-cache-dir --constraint requirements.txt \
      nanobind numpy scikit-build-core setuptools

COPY core core
RUN CMAKE_BUILD_PARALLEL_LEVEL=$JOBS /opt/build/bin/pip wheel --quiet --no-cache-dir \
      --no-build-isolation --no-deps --wheel-dir wheels ./core \
 && python -m pip --python /opt/covinz/bin/python install --quiet --no-deps wheels/*.whl

# As in a checkout: `covinz` is imported from where `services` lies next to it.
WORKDIR /app
COPY LICENSE NOTICE README.md pyproject.toml ./
COPY vocabulary/orb_10k.bin vocabulary/sift_10k.bin vocabulary/
COPY covinz covinz
COPY services services
RUN python -m pip --python /opt/covinz/bin/python install --quiet --no-cache-dir --no-deps -e . \
 && rm -rf covinz.egg-info build \
 && /opt/covinz/bin/python -m compileall -q --invalidation-mode unchecked-hash covinz services


FROM python:3.11-slim-bookworm
LABEL org.opencontainers.image.title="covinz" \
      org.opencontainers.image.description="Collaborative SLAM server" \
      org.opencontainers.image.licenses="Apache-2.0" \
      covinz.licences="covinz is Apache-2.0. What comes with it has licences of its own, in /usr/share/doc/*/copyright and /opt/covinz/lib/python3.11/site-packages/*.dist-info."

# tini ends with its child, hands signals on, and lets a process be killed from inside its container.
COPY --from=build /no-gl.deb /tmp/
RUN apt-get update -qq \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends /tmp/no-gl.deb \
      libopencv-core406 libopencv-features2d406 libopengv1 tini \
 && rm -rf /var/lib/apt/lists/* /tmp/no-gl.deb \
 && useradd --uid 10001 --home-dir /app --no-create-home --shell /usr/sbin/nologin covinz \
 && install -d -o covinz -g covinz -m 700 /roster \
 && install -d -o covinz -g covinz /backup /server/ingest /server/place_recognition \
      /server/optimizer \
 && install -d -o covinz -g covinz /data

COPY --from=build /opt/covinz /opt/covinz
COPY --from=build /app /app

WORKDIR /app
ENV PATH=/opt/covinz/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    OMP_NUM_THREADS=1 \
    OPENBLAS_NUM_THREADS=1
# A library that is missing is noticed here, not on the server.
RUN python -c "import covinz.cli, covinz_core, services.place_recognition.service"

USER covinz
EXPOSE 7447
EXPOSE 7447/udp
ENTRYPOINT ["tini", "--"]
# The whole server in one container; compose runs one process in each instead.
CMD ["covinz", "up", "--data", "/data"]
