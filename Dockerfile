# A world of turtles, and its page. In this folder:
#
#     docker build -t turtleact .
#     docker run --rm -p 9090:9090 turtleact
#
# Open the address that it prints. After the name of the image you may give any arguments of the
# command line: docker run --rm turtleact send-goal fibonacci "order: 5"

FROM python:3.11-slim AS build
COPY . /source
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /dist /source

FROM python:3.11-slim
COPY --from=build /dist /dist
RUN pip install --no-cache-dir /dist/*.whl
USER 1000
EXPOSE 9090
ENTRYPOINT ["turtleact"]
CMD ["serve", "--web", "0.0.0.0:9090"]
