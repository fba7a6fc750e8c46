// A press by node-opcua with the OPC Foundation's NodeSets, whose cycles `history covariates --opcua` follows:
// npm install node-opcua-server node-opcua-nodesets node-opcua-certificate-manager; node opcua_press.js DATA PORT PKI
// DATA: sim/data; PKI: folder of its certificate and of those it trusts. PASSWORD=… lets in nobody but "setter".
const path = require("path");
const { OPCUAServer } = require("node-opcua-server");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const { nodesets } = require("node-opcua-nodesets");
const { DataType, VariantArrayType } = require("node-opcua-variant");
const NODESETS = ["Di", "PlasticsRubber.GeneralTypes", "PlasticsRubber.IMM2MES"];
const PLASTICS = "http://opcfoundation.org/UA/PlasticsRubber/";
async function main() {
  const [data, port, pki] = process.argv.slice(2), password = process.env.PASSWORD;
  const server = new OPCUAServer({
    port: Number(port), hostname: "127.0.0.1", resourcePath: "/press",
    serverCertificateManager: new OPCUACertificateManager({ rootFolder: pki }),
    nodeset_filename: [nodesets.standard, ...NODESETS.map(name => path.join(data, `Opc.Ua.${name}.NodeSet2.xml`))],
    allowAnonymous: password === undefined,
    userManager: { isValidUser: (name, given) => name === "setter" && given === password },
  });
  await server.initialize();
  const space = server.engine.addressSpace;
  const general = space.getNamespaceIndex(`${PLASTICS}GeneralTypes/`), imm = space.getNamespaceIndex(`${PLASTICS}IMM2MES/`);
  const own = space.registerNamespace("urn:press:maker");
  const type = own.addEventType({ browseName: "MakersCycleEventType", subtypeOf: space.findNode(`ns=${general};i=1038`) });
  const part = "InjectionUnitCycleParameters_1";
  const unit = own.addObject({ browseName: { name: part, namespaceIndex: own.index }, componentOf: type, modellingRule: "Mandatory" });
  const scalar = (dataType, value) => ({ dataType, arrayType: VariantArrayType.Scalar, value });
  const add = (how, parent, name, namespaceIndex, value) => own.addVariable({
    browseName: { name, namespaceIndex }, [how]: parent, dataType: value.dataType, modellingRule: "Mandatory", value });
  add("componentOf", unit, "CushionVolume", imm, scalar(DataType.Double, 0));
  add("componentOf", unit, "MaterialTemperature", imm, scalar(DataType.Float, 0));
  add("propertyOf", type, "PartId", general, scalar(DataType.String, ""));
  add("propertyOf", type, "MachineCycleCounter", general, scalar(DataType.UInt64, [0, 0]));
  await server.start();
  console.log(`press at ${server.getEndpointUrl()}`);
  let cycle = 0;
  setInterval(() => {
    cycle += 1;
    space.rootFolder.objects.server.raiseEvent(type, {
      sourceName: scalar(DataType.String, "press"), severity: scalar(DataType.UInt16, 100), message: scalar(DataType.LocalizedText, { text: "cycle" }),
      partId: scalar(DataType.String, `N-${cycle}`), machineCycleCounter: scalar(DataType.UInt64, [0, cycle]), jobCycleCounter: scalar(DataType.UInt64, [0, cycle]),
      cycleTime: scalar(DataType.Double, 30500 + cycle), averageCycleTime: scalar(DataType.Double, 30500),
      [`${part}.cushionVolume`]: scalar(DataType.Double, 12.5 + cycle), [`${part}.materialTemperature`]: scalar(DataType.Float, 231.5),
    });
  }, 1000);
}
main().catch(problem => { console.error(problem); process.exit(1); });
