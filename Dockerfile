# docker build -t slamcheck .
# docker run --rm slamcheck                            the main job: Victoria Park through both estimators
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/work" slamcheck run my-log   a log of this folder
#
# With the extra for scans: docker build --build-arg EXTRAS='[scans]' -t slamcheck .
FROM python:3.12-slim
ARG EXTRAS=""
# Open3D needs libraries that the slim image lacks; without scans there is nothing to add.
RUN if [ -n "$EXTRAS" ]; then \
        apt-get update \
        && apt-get install --yes --no-install-recommends libgl1 libegl1 libx11-6 libgomp1 \
        && rm -rf /var/lib/apt/lists/*; \
    fi
COPY . /source
RUN pip install --no-cache-dir "/source$EXTRAS" && rm -rf /source
RUN useradd --create-home slamcheck && install --directory --owner=slamcheck /work
USER slamcheck
WORKDIR /work
ENV MPLCONFIGDIR=/tmp/matplotlib
ENTRYPOINT ["slamcheck"]
CMD ["run"]
